"""Fitting of TouchNet ``geometric`` to tactile images."""

from collections.abc import Callable
from functools import cache

import numpy as np

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.fit import CurvePoint, Session
from objectfolder.touch.geometric_net import GeometricTouch
from objectfolder.touch.net_settings import TouchConfig
from objectfolder.touch.profiles import SensorProfile

#: Candidate rounds of smoothing for renderer tacto.
SMOOTHING = (1, 2, 4, 8)
ROWS = ("images", "points", "angles", "depths")  #: what is learnt from


def train(
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    scale: float,
    profile: SensorProfile,
    surface: Callable[[], Isosurface],
    settings: TouchConfig,
    session: Session,
) -> tuple[GeometricTouch, list[CurvePoint]]:
    """Train a net of this kind, as the stage asks."""
    net = GeometricTouch(surface(), scale, profile, renderer=str(train["renderer"]))
    first, held_out = ({name: rows[name][: settings.contacts] for name in ROWS} for rows in (train, val))
    return net, fit_contacts(net, first, held_out, settings.offset_span, settings.rounds, session.report)


def fit_contacts(
    net: GeometricTouch,
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    span: float,
    rounds: int,
    report: Callable[[CurvePoint], None] = lambda point: None,
) -> list[CurvePoint]:
    """Choose the depth offset that best reproduces the training images, by bisection of a bracket.

    Offsets from -span to span (metres) are searched in so many rounds, each of which halves the bracket. For
    renderer tacto the smoothing of normals is then chosen among the present one and `SMOOTHING`. Both are set
    in place. Contacts are those of `objectfolder.touch.truth.render_contacts`; losses of the curve are mean
    squared errors of images in [0, 1].
    """
    train, val = (c | {"normals": net.normals(c["points"])} for c in (train, val))
    curve: list[CurvePoint] = []

    def loss(contacts: dict[str, np.ndarray]) -> float:
        images = net.images(*(contacts[name] for name in ("points", "normals", "angles", "depths")))
        return float(np.mean((images / 255.0 - contacts["images"] / 255.0) ** 2))

    def loss_at(offset: float) -> float:
        net.depth_offset = offset
        return loss(train)

    def loss_with(smoothing: int) -> float:
        net.smooth(smoothing)
        return loss(train)

    @cache
    def val_loss(offset: float, smoothing: int) -> float:
        return loss(val)

    def record() -> None:
        held_out = val_loss(net.depth_offset, net.smoothing)
        curve.append(CurvePoint(len(curve) + 1, best_loss, held_out, 0.0))
        report(curve[-1])

    best, step = 0.0, span / 2
    best_loss = loss_at(best)
    for _ in range(rounds):
        losses = {offset: loss_at(offset) for offset in (best - step, best + step)}
        candidate = min(losses, key=losses.__getitem__)
        if losses[candidate] < best_loss:
            best, best_loss = candidate, losses[candidate]
        net.depth_offset = best
        step /= 2
        record()
    if net.renderer == "tacto":
        tried = {net.smoothing: best_loss} | {smoothing: loss_with(smoothing) for smoothing in SMOOTHING}
        chosen = min(tried, key=tried.__getitem__)
        net.smooth(chosen)
        best_loss = tried[chosen]
        record()
    return curve
