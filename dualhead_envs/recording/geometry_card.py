"""The schema of a recorded dataset's geometry card, ``card.json``: measured quantities beside the paper's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from dualhead_envs.validated_json import Label, Schema, printable, read_validated

Bounds = Field(ge=-1e12, le=1e12)
#: A measured quantity; None where it is not defined.
Quantity = Annotated[int, Bounds] | Annotated[float, Bounds] | None
#: A line of explanation.
Explanation = Annotated[str, Field(max_length=500), AfterValidator(printable)]


class GeometryCard(Schema):
    """The content of ``card.json``.

    Attributes:
        format: Version of the format.
        env_id: Environment that the dataset was recorded from.
        horizon: Actions in a window.
        measured: Measured quantities by name.
        paper: What the paper prints for some of them.
        single_feature: The scalar that tells the modes best.
        meanings: What each quantity means.
    """

    format: Literal["dualhead-card/1"]
    env_id: Label
    horizon: Annotated[int, Field(ge=1)]
    measured: Annotated[dict[Label, Quantity], Field(min_length=1)]
    paper: dict[Label, Quantity]
    single_feature: Explanation
    meanings: dict[Label, Explanation]


def read_geometry_card(path: Path) -> GeometryCard:
    """The geometry card in a file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no geometry card.
    """
    return read_validated(path, GeometryCard, kind="a geometry card", remedy="record the dataset again")
