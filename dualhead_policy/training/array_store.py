"""Arrays held once per machine: runs and processes that need the same numbers map the same file."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

import numpy as np
import torch
from torch import Tensor


class ArrayStore:
    """A folder of arrays, each named by the digest of its content and mapped into memory by whoever asks for it.

    Args:
        folder: The folder; it can be deleted whenever no process uses it.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._held: dict[str, Tensor] = {}

    def shared(self, tensor: Tensor) -> Tensor:
        """A tensor of ``tensor``'s content, in memory that every process of the machine shares.

        Tensors of accelerators are shared within this process only.
        """
        values = tensor.detach().cpu().contiguous().numpy()
        digest = hashlib.sha256(repr((values.shape, values.dtype.str)).encode())
        digest.update(values.data if values.size else b"")
        key = digest.hexdigest()
        if key not in self._held:
            self._held[key] = self._mapped(key, values) if tensor.device.type == "cpu" else tensor
        return self._held[key]

    def _mapped(self, key: str, values: np.ndarray) -> Tensor:
        path = self.folder / f"{key}.npy"
        if not path.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=self.folder, suffix=".partial")
            try:
                with os.fdopen(handle, "wb") as file:
                    np.save(file, values, allow_pickle=False)
                os.replace(temporary, path)
            except BaseException:
                Path(temporary).unlink(missing_ok=True)
                raise
        # Copy on write: torch wants memory that it may write to, and nobody else would see what is written.
        return torch.from_numpy(np.load(path, mmap_mode="c", allow_pickle=False))
