"""What is kept of an arm on the log: scores per decision, and counts of its samples' modes."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dualhead_eval.atomic_text import write_bytes

FORMAT = "dualhead-monitor-arm/1"
_METADATA = b"dualhead"
#: Bits of a stored score's fraction, a relative step of 1/512 at most. Verdicts are those of the stored numbers.
FRACTION_BITS = 9


@dataclass(frozen=True)
class ArmScores:
    """An arm's scores of D decisions, in the order of the log.

    Attributes:
        scores: Score of every signal ``(D,)``, infinite where a decision diverged.
        crossed: Whether the executed pair lies on two sides ``(D,)``.
        pairs: Both-valid pairs by the modes of head A and head B ``(D, K, K)``.
        followed: Valid chunks of either head by token and mode ``(D, 2, T, K)``; None without tokens.
        entropy: Entropy of the token's prior ``(D,)`` in nat; None without tokens.
        provenance: What is known of the policy and the draws.
    """

    scores: dict[str, NDArray[np.float32]]
    crossed: NDArray[np.bool_]
    pairs: NDArray[np.uint8]
    followed: NDArray[np.uint8] | None
    entropy: NDArray[np.float32] | None
    provenance: dict[str, Any]

    @classmethod
    def empty(
        cls, decisions: int, signals: list[str], n_modes: int, n_tokens: int | None, provenance: dict[str, Any]
    ) -> ArmScores:
        """Room for the scores of so many decisions."""
        return cls(
            {name: np.zeros(decisions, dtype=np.float32) for name in signals},
            np.zeros(decisions, dtype=bool),
            np.zeros((decisions, n_modes, n_modes), dtype=np.uint8),
            None if n_tokens is None else np.zeros((decisions, 2, n_tokens, n_modes), dtype=np.uint8),
            None if n_tokens is None else np.zeros(decisions, dtype=np.float32),
            provenance,
        )

    def only(self, signals: Sequence[str]) -> ArmScores:
        """The same with some of the signals."""
        return replace(self, scores={name: values for name, values in self.scores.items() if name in signals})

    def write(self, path: Path) -> None:
        """Write one Parquet file, atomically."""
        columns = {f"score.{name}": pa.array(coarse(values)) for name, values in self.scores.items()}
        columns["crossed"] = pa.array(self.crossed)
        columns["pairs"] = _listed(self.pairs)
        shapes = {"pairs": list(self.pairs.shape[1:])}
        if self.followed is not None and self.entropy is not None:
            columns |= {"followed": _listed(self.followed), "entropy": pa.array(coarse(self.entropy))}
            shapes["followed"] = list(self.followed.shape[1:])
        document = json.dumps({"format": FORMAT, "shapes": shapes, "provenance": self.provenance})
        content = io.BytesIO()
        pq.write_table(
            pa.table(columns).replace_schema_metadata({_METADATA: document.encode()}),
            content,
            compression="zstd",
            compression_level=19,
            write_page_checksum=True,
            # Bytes of one significance beside each other: half the size of plain floats.
            use_dictionary=False,
            column_encoding={name: "BYTE_STREAM_SPLIT" for name, kind in columns.items() if kind.type == pa.float32()},
        )
        write_bytes(path, content.getvalue())

    @classmethod
    def read(cls, path: Path) -> ArmScores:
        """Read a file.

        Raises:
            FileNotFoundError: If there is none.
            ValueError: If it is damaged or of another kind.
        """
        if not path.is_file():
            raise FileNotFoundError(f"{path} does not exist, expected an arm's scores: repeat the study's command")
        try:
            table = pq.read_table(path, page_checksum_verification=True)
            document = json.loads((table.schema.metadata or {}).get(_METADATA, b"{}"))
            if document.get("format") != FORMAT:
                raise ValueError(f"its format is {document.get('format')!r}")
            scores = {
                name.removeprefix("score."): table[name].to_numpy().astype(np.float32)
                for name in table.column_names
                if name.startswith("score.")
            }
            if not scores or any(np.isnan(values).any() for values in scores.values()):
                raise ValueError("it lacks scores, or some are not numbers")
            arrays = {
                name: np.stack(table[name].to_numpy(zero_copy_only=False)).reshape(-1, *shape)
                for name, shape in document["shapes"].items()
            }
            entropy = table["entropy"].to_numpy() if "followed" in arrays else None
            return cls(
                scores,
                table["crossed"].to_numpy(zero_copy_only=False),
                arrays["pairs"],
                arrays.get("followed"),
                entropy,
                document["provenance"],
            )
        except (pa.ArrowException, OSError, KeyError, TypeError, AttributeError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(
                f"{path} holds no scores of an arm ({reason}): delete it, and repeat the study's command"
            ) from error


def coarse(values: NDArray) -> NDArray[np.float32]:
    """Values with :data:`FRACTION_BITS` bits of fraction, NaN as infinity."""
    single = np.where(np.isnan(values), np.inf, values).astype(np.float32)
    mantissa, exponent = np.frexp(single)
    scale = np.float32(2 ** (FRACTION_BITS + 1))
    return np.where(np.isfinite(single), np.ldexp(np.round(mantissa * scale) / scale, exponent), single).astype(
        np.float32
    )


def _listed(values: NDArray[np.uint8]) -> pa.FixedSizeListArray:
    flat = values.reshape(len(values), -1)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])
