"""Raw observations through a policy's preprocessor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from dualhead_policy.modeling_dualhead import DualheadPolicy


def preprocessed(preprocessor: Any, policy: DualheadPolicy, raw: dict[str, np.ndarray]) -> Tensor:
    """Preprocessed observations (B, C) of raw ones by LeRobot key, each (B, dim)."""
    batch = preprocessor({key: torch.from_numpy(raw[key]) for key in policy.observation_keys})
    return torch.cat([batch[key] for key in policy.observation_keys], dim=-1)
