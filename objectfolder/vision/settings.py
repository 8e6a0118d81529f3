"""Settings of views: section ``render_views`` of ``params.yaml``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, MultipleOf

from objectfolder.base.settings import Count, NonNegative, section

RendererName = Literal["mitsuba", "mitsuba-llvm", "mitsuba-cuda", "cycles", "raster"]
MIN_RESOLUTION = 11  #: pixels along a side of a whole view: the window of the SSIM that ``evaluate`` takes


@section("render_views")
@dataclass(frozen=True, kw_only=True)
class RenderViewsConfig:
    """Section ``render_views`` of ``params.yaml``."""

    renderer: RendererName = "mitsuba"  #: docs/pipeline.md compares them
    ambient: NonNegative = 0.0  #: radiance from every direction, beside the point light
    resolution: Count = 256  #: pixels along a side of a whole view
    #: pixels along a side of a tile; null: train and val are whole views
    tile: Annotated[int, Ge(3)] | None = 24
    train: Count = 1200  #: tiles or views
    val: Count = 50
    test: Count = 24  #: always whole views
    train_samples: Count = 4  #: per pixel; Mitsuba rounds up to a product of two nearly equal numbers
    test_samples: Annotated[int, Ge(2), MultipleOf(2)] = 32  #: per pixel, validation and test: two halves

    def __post_init__(self) -> None:
        """Refuse views that could be built but not evaluated."""
        if self.resolution < MIN_RESOLUTION:
            raise ValueError(
                f"resolution is {self.resolution}, expected at least {MIN_RESOLUTION}: the SSIM that "
                f"evaluates the views looks through a window of {MIN_RESOLUTION} x {MIN_RESOLUTION} pixels"
            )
