"""Markers printed on the gel: where they move, and how the camera sees them."""

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.ndimage loads at first use

from objectfolder.base.checks import finite_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.camera import gel_depth
from objectfolder.touch.profiles import SensorProfile

_INK = 30.0  # grey level


@dataclass(frozen=True)
class Markers:
    """A square grid of black dots on the gel, centred in the image."""

    spacing: float = 1.5e-3  #: m, between centres
    radius: float = 2.5e-4  #: m

    def __post_init__(self) -> None:
        """Check that dots are apart."""
        spacing = finite_number("markers: spacing", self.spacing)
        radius = finite_number("markers: radius", self.radius)
        if not 0 < 2 * radius < spacing:
            raise ObjectFolderError(
                f"markers of radius {radius:g} m, {spacing:g} m apart, expected a radius above 0 and under "
                "half of the spacing"
            )

    def places(self, profile: SensorProfile) -> np.ndarray:
        """Return columns and rows of the dots on the untouched gel; (M, 2) float64, pixels."""
        step = self.spacing / profile.pixel_pitch
        axes = []
        for pixels in (profile.width, profile.height):
            count = int((pixels - 2 * self.radius / profile.pixel_pitch) // step) + 1
            axes.append((pixels - 1) / 2 + step * (np.arange(count) - (count - 1) / 2))
        return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def marker_flow(
    places: np.ndarray, sideways: np.ndarray, displacement: np.ndarray, profile: SensorProfile
) -> np.ndarray:
    """Return how markers move in the images; (N, M, 2) float32, pixels along columns and rows.

    A point of the gel moves sideways (N, H, W, 2), right and up in the image, and towards the camera, by the
    displacement (N, H, W), which enlarges its distance from the axis; metres. Places (M, 2) are columns and
    rows on the untouched gel.
    """
    at, map_coordinates = places.T[::-1], scipy.ndimage.map_coordinates
    focal = profile.camera_to_gel / profile.pixel_pitch  # pixels per unit slope of a ray
    depth = map_coordinates(gel_depth(profile), at, order=1, mode="nearest")
    centre = np.array([(profile.width - 1) / 2, (profile.height - 1) / 2])
    from_axis = places - centre
    flow = np.empty((len(sideways), len(places), 2), np.float32)
    for out, shift, towards in zip(flow, sideways, displacement):
        images = shift[..., 0], shift[..., 1], towards
        right, up, nearer = (map_coordinates(image, at, order=1, mode="nearest") for image in images)
        moved = from_axis * depth[:, None] + focal * np.stack([right, -up], axis=1)
        out[:] = moved / (depth - nearer)[:, None] - from_axis
    return flow


def draw_markers(
    images: np.ndarray, places: np.ndarray, flow: np.ndarray, markers: Markers, profile: SensorProfile
) -> np.ndarray:
    """Return images (N, H, W, 3) uint8 with the markers where they have moved.

    Places (M, 2) are those of `Markers.places`, the flow (N, M, 2) that of `marker_flow`. Edges are smooth
    over a pixel. Dots keep their size.
    """
    height, width = images.shape[1:3]
    radius = markers.radius / profile.pixel_pitch
    reach = int(np.ceil(radius + 1))
    offsets = np.arange(-reach, reach + 1)
    drawn = images.copy()
    for image, moved in zip(drawn, places + flow):
        nearest = moved.round().astype(int)
        columns = nearest[:, 0, None, None] + offsets
        rows = nearest[:, 1, None, None] + offsets[:, None]
        distance = np.hypot(columns - moved[:, 0, None, None], rows - moved[:, 1, None, None])
        cover = np.zeros((height + 2 * reach, width + 2 * reach))
        rows, columns = np.broadcast_arrays(rows, columns)
        across, down = abs(columns - width / 2), abs(rows - height / 2)
        inside = (across < width / 2 + reach) & (down < height / 2 + reach)
        pixels = rows[inside] + reach - 1, columns[inside] + reach - 1
        np.maximum.at(cover, pixels, np.clip(radius + 0.5 - distance, 0, 1)[inside])
        cover = cover[reach - 1 : reach - 1 + height, reach - 1 : reach - 1 + width, None]
        image[:] = (image + cover * (_INK - image)).round()
    return drawn
