"""Which dimensions of the dual action vector are which representation, and the map between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, ClassVar

GROUPS = ("joint", "position", "rotation", "gripper")
#: Longest name of a dimension or kinematic map, in characters; a map's name may hold a file's path.
LONGEST_NAME = 4096


@dataclass
class RepresentationLayout:
    """The dual action vector as a policy sees it; part of the policy's configuration.

    Attributes:
        joint: Names of head A's dimensions (rad on robots; the chosen representation on the ring).
        position: Names of head B's dimensions (m).
        rotation: Names of the 6-D rotation's dimensions, or empty.
        gripper: Name of the gripper's dimension, or empty.
        kinematic_map: The map from head A's space to the position: ``"panda"``, ``"ring/nullspace"``, ...
    """

    joint: list[str] = field(default_factory=list)
    position: list[str] = field(default_factory=list)
    rotation: list[str] = field(default_factory=list)
    gripper: list[str] = field(default_factory=list)
    kinematic_map: str = ""

    #: How pydantic checks the layout in a policy's folder.
    __pydantic_config__: ClassVar = {"extra": "forbid"}

    def __post_init__(self) -> None:
        for name in [*self.names, self.kinematic_map]:
            if not name.isprintable() or len(name) > LONGEST_NAME:
                raise ValueError(
                    f"the action layout holds the name {name[:LONGEST_NAME]!a}, expected printable text of at "
                    f"most {LONGEST_NAME} characters: rename that dimension"
                )

    @property
    def ring_map(self) -> str | None:
        """Name of the ring's representation map (``"nullspace"``, ...), or None off the ring."""
        family, _, name = self.kinematic_map.partition("/")
        return name if family == "ring" else None

    @property
    def names(self) -> list[str]:
        """Names of the whole dual action vector, in order."""
        return [*self.joint, *self.position, *self.rotation, *self.gripper]

    @property
    def slices(self) -> dict[str, slice]:
        """Where each group lies in the dual action vector."""
        slices, start = {}, 0
        for group in GROUPS:
            width = len(getattr(self, group))
            slices[group] = slice(start, start + width)
            start += width
        return slices

    @classmethod
    def from_names(cls, names: Sequence[str] | None) -> RepresentationLayout:
        """The layout spelled by a dataset's action names (``joint.*``, ``position.*``, ...).

        Raises:
            ValueError: If the names are not those of a dual action vector.
        """
        names = list(names or [])
        groups = {group: [n for n in names if n.split(".")[0] == group] for group in GROUPS}
        if not groups["joint"] or not groups["position"] or [*chain(*groups.values())] != names:
            shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            raise ValueError(
                f"the dataset's action is named [{shown}], not joint.* followed by position.* "
                "(then rotation.*, gripper): train on a dataset with the dual action vector, as `dualhead record` "
                "writes it"
            )
        parts = groups["joint"][0].split(".")
        kinematic_map = f"ring/{parts[1]}" if len(parts) == 3 else "panda"
        return cls(**groups, kinematic_map=kinematic_map)

    def require_same(self, other: RepresentationLayout, *, owner: str, given: str) -> None:
        """Refuse data of another layout.

        Raises:
            ValueError: In one sentence, with the first differing dimension.
        """
        if self == other:
            return
        ours, theirs = self.names, other.names
        where = next((i for i, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), None)
        if where is None:
            difference = f"{len(theirs)} dimensions instead of {len(ours)}"
            if len(ours) == len(theirs):
                difference = f"kinematic map {other.kinematic_map!r} instead of {self.kinematic_map!r}"
        else:
            difference = f"{theirs[where]!r} instead of {ours[where]!r} at index {where}"
        raise ValueError(
            f"{given} has another action layout than {owner}: {difference}; use data of the "
            f"{self.kinematic_map!r} layout or train a new policy"
        )


def require_observations(expected: Mapping[str, Any], given: Mapping[str, int]) -> None:
    """Refuse observations of other widths than a policy's input features.

    Args:
        expected: The policy's input features.
        given: Widths of what the environment or dataset observes, by LeRobot key; others are not compared.

    Raises:
        ValueError: In one sentence, with the first difference.
    """
    for key, width in given.items():
        if key in expected and expected[key].shape[0] != width:
            raise ValueError(
                f"the environment or dataset has {width} dimensions in {key}, the policy was trained on "
                f"{expected[key].shape[0]}: use the environment that the policy was trained on"
            )
