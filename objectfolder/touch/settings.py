"""Settings of tactile images: section ``render_touch`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Literal

from objectfolder.base.settings import Count, NonNegative, section


@section("render_touch")
@dataclass(frozen=True, kw_only=True)
class RenderTouchConfig:
    """Section ``render_touch`` of ``params.yaml``."""

    #: random points by area, or vertices (as the paper)
    locations: Literal["surface", "vertices"] = "surface"
    #: of the pressed surface (`objectfolder.touch.contact.contact_normals`), or the mesh's (the paper)
    normals: Literal["contact", "vertex"] = "contact"
    train: Count | None = 64  #: contacts; with ``vertices`` at most, and null: every vertex of the split
    val: Count | None = 32
    test: Count | None = 128
    renderer: Literal["gel", "tacto"] = "gel"  #: the deformed gel, or TACTO's rendering (sensor: tacto_digit)
    depth: NonNegative | None = None  #: of every contact, metres; null: random up to the sensor's press_depth
    angle: float | None = None  #: of every contact, radians; null: random

    def __post_init__(self) -> None:
        """Refuse what random points do not have."""
        missing = [name for name in ("train", "val", "test") if getattr(self, name) is None]
        if missing and self.locations == "surface":
            raise ValueError(
                f"{missing[0]} is null, expected a number of contacts; null is for locations: vertices"
            )
        if self.normals == "vertex" and self.locations == "surface":
            raise ValueError("normals is vertex, which needs locations: vertices; expected contact")
