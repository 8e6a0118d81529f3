"""Sections of ``params.yaml`` about the samples of benchmarks: ``observe``, ``decompose``, ``grasp_data``."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval, MultipleOf

from objectfolder.base.settings import Count, Positive, section


@section("observe")
@dataclass(frozen=True, kw_only=True)
class ObserveConfig:
    """Section ``observe``: random views, impacts and touches of each object."""

    observations: Annotated[int, Ge(10), MultipleOf(10)] = 80  #: per modality
    resolution: Annotated[int, Ge(8)] = 64  #: side of the views, pixels
    depth: Positive | None = None  #: of all presses, m; null: at random in the sensor's range


@section("decompose")
@dataclass(frozen=True, kw_only=True)
class DecomposeConfig:
    """Section ``decompose``: the surface as convex hulls."""

    hulls: Count = 8  #: greatest number of hulls of an object


@section("grasp_data")
@dataclass(frozen=True, kw_only=True)
class GraspDataConfig:
    """Section ``grasp_data``: grasps to collect of each object."""

    grasps: Annotated[int, Ge(10), MultipleOf(10)] = 200
    perturbations: Annotated[int, Ge(0)] = 2  #: perturbed repetitions of each grasp for the soft label
    image: Annotated[int, Ge(8)] = 64  #: side of the camera's pictures, pixels
    touch: tuple[int, int] = (64, 48)  #: height and width of tactile images, pixels; the sensor's: 160, 120
    timestep: Annotated[float, Interval(gt=0, le=0.004)] = 0.002  #: of the simulation, s

    def bytes(self, explicit: bool) -> int:
        """Return the size of the images of a grasp."""
        return 3 * (self.image**2 + 2 * (1 + explicit) * self.touch[0] * self.touch[1])
