"""The dual-head flow-matching policy as a LeRobot plugin, and its fast trainer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dualhead_policy.configuration_dualhead import DualheadConfig
    from dualhead_policy.modeling_dualhead import DualheadPolicy
    from dualhead_policy.sampling import HeadSamples, SamplingCoupling

__all__ = ["DualheadConfig", "DualheadPolicy", "HeadSamples", "SamplingCoupling"]

_HOMES = {
    "DualheadConfig": "configuration_dualhead",
    "DualheadPolicy": "modeling_dualhead",
    "HeadSamples": "sampling",
    "SamplingCoupling": "sampling",
}


def __getattr__(name: str) -> Any:
    # Importing lerobot takes seconds; `dualhead --help` must not pay for it.
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(f"dualhead_policy.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'dualhead_policy' has no attribute {name!r}")
