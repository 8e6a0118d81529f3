"""Training of VisionNet ``surface``: first on the mesh's appearance at surface points, then on views."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from scipy.ndimage import maximum_filter, minimum_filter

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.fit import CurvePoint, FitSettings, Session, fit, minibatches
from objectfolder.nets.hashgrid import HashGrid
from objectfolder.vision.appearance import appearance_at
from objectfolder.vision.cameras import camera_rays, image_intrinsics
from objectfolder.vision.color import MIN_FOREGROUND_ALPHA
from objectfolder.vision.net_settings import SurfaceConfig, VisionConfig
from objectfolder.vision.scene import Scene
from objectfolder.vision.surface_net import CHUNK, Baked, BounceInputs, SurfaceNet, in_cube
from objectfolder.vision.trace import trace
from objectfolder.vision.vectors import take_rows

# Weight of errors of the shading normal, relative to those of the colour. A detailed texture takes most of
# the hash grid: at weight 1 it leaves a degree of noise to normals, which grazing light shows as speckles.
NORMALS = 5.0
_TOGETHER = 4  # images with the same light that are traced at once: as many tiles as share one
DARK = 0.002  # radiance below which a pixel is nearly black
DARK_SHARE = 0.2  # sampling probability of dark pixels, relative to others


@dataclass(frozen=True)
class _Points:
    """Points of the stored surface with the mesh's appearance there."""

    points: torch.Tensor  # (S, 3)
    normals: torch.Tensor  # (S, 3), of the stored surface
    corners: tuple[torch.Tensor, torch.Tensor]
    color: torch.Tensor  # (S, 3), sRGB
    shading: torch.Tensor  # (S, 3), unit

    def __len__(self) -> int:
        return len(self.points)

    def loss(self, net: SurfaceNet, index: torch.Tensor) -> torch.Tensor:
        features = net.grid.lookup(*(take_rows(v, index) for v in self.corners))
        values = self.points, self.normals, self.color, self.shading
        points, normals, true_color, true_shading = (take_rows(v, index) for v in values)
        color, shading = net.albedo_and_normal(points, normals, features)
        return F.mse_loss(color, true_color) + NORMALS * F.mse_loss(shading, true_shading)


@dataclass(frozen=True)
class _Pixels:
    """Pixels of views inside the object, away from shadow edges, with all quantities that stay fixed."""

    inputs: BounceInputs
    base_color: torch.Tensor  # (S, 3) linear
    direct: torch.Tensor  # (S, 3) linear
    target: torch.Tensor  # (S, 3) linear, at most 1
    corners: tuple[torch.Tensor, torch.Tensor]

    def __len__(self) -> int:
        return len(self.target)

    def loss(self, net: SurfaceNet, index: torch.Tensor) -> torch.Tensor:
        transport = net.transport.lookup(*(take_rows(v, index) for v in self.corners))
        diffuse, glossy = net.indirect(self.inputs.select(index), transport)
        values = self.direct, self.base_color, self.target
        direct, base_color, target = (take_rows(v, index) for v in values)
        radiance = (direct + base_color * diffuse + glossy).clamp(max=1)
        # Linearised sRGB error: noisy samples have the right mean in linear radiance, not after encoding.
        error = (radiance - target) * srgb.encode_slope(radiance.detach())
        return error.square().mean()


def train(
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    surface: Callable[[], Isosurface],
    scene: Callable[[], Scene],
    settings: VisionConfig,
    session: Session,
) -> tuple[SurfaceNet, list[CurvePoint]]:
    """Train a net of this kind, as the stage asks."""
    return train_surface(surface(), scene(), train, val, settings, session)


def train_surface(
    surface: Isosurface,
    scene: Scene,
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    config: SurfaceConfig,
    session: Session,
) -> tuple[SurfaceNet, list[CurvePoint]]:
    """Fit a `SurfaceNet` to a mesh's appearance, then to views of it, on the CPU.

    Training points lie on the stored surface because queries do. Views are whole or tiles, see
    `objectfolder.vision.truth`: ``rgba`` (N, H, W, 4), ``camera_to_world`` (N, 4, 4), ``light`` (N, 3),
    ``focal``, ``center`` (N, 2). The curve is that of the training on views; losses are mean squared errors
    in sRGB over pixels inside the object.
    """
    generator = session.generator
    with session.initialisation():
        grid = HashGrid(config.levels, config.features, config.table_bits, config.coarsest, config.finest)
        net = SurfaceNet(grid, config.width, scene.roughness, scene.metallic)
    rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))

    def fit_to(
        learn: _Points | _Pixels,
        check: _Points | _Pixels,
        settings: FitSettings,
        batch: int,
        session: Session,
    ) -> list[CurvePoint]:
        batches = iter(minibatches(len(learn), batch, generator))
        chunks = torch.arange(len(check)).split(CHUNK)
        return fit(
            net,
            batch_loss=lambda: learn.loss(net, next(batches)),
            val_loss=lambda: sum(check.loss(net, c).item() * len(c) for c in chunks) / len(check),
            settings=settings,
            session=session,
        )

    known, unknown = (_look_up(surface, scene, net, n, rng) for n in (config.points, config.points // 20))
    # To the last step: where normals cannot be learned, the validation loss rises before colours are done.
    to_the_end = FitSettings(config.point_steps, config.learning_rate, evaluations=1)
    fit_to(known, unknown, to_the_end, config.point_batch, Session(generator))
    _scale_correction(net, unknown)
    # Train indirect light on the quantised net, as queries use it.
    net = SurfaceNet.from_tensors(*net.to_tensors())
    baked = net.bake(surface)
    pixels = _gather(surface, net, baked, train, config.pixels, DARK_SHARE, rng)
    held_out = _gather(surface, net, baked, val, config.pixels, 1, rng)
    curve = fit_to(pixels, held_out, FitSettings(config.steps, config.learning_rate), config.batch, session)
    return net.eval(), curve


def _look_up(
    surface: Isosurface, scene: Scene, net: SurfaceNet, count: int, rng: np.random.Generator
) -> _Points:
    """Sample random points of the surface, with the mesh's appearance at the closest points."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, count, seed=rng)
    color, looked_up = appearance_at(scene, points)
    p = torch.from_numpy(points.astype(np.float32))
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)
    corners = surface.shading.normals[surface.shading.faces[face]]
    mixed = np.einsum("sk,skc->sc", weights, corners).astype(np.float32)
    normals = F.normalize(torch.from_numpy(mixed), dim=1)
    shading = torch.from_numpy(looked_up)
    # Meshes may have inverted faces; renderers flip their normals towards the camera, which is outside.
    shading = torch.where((shading * normals).sum(1, keepdim=True) < 0, -shading, shading)
    encoded = torch.from_numpy(srgb.encode(color).astype(np.float32))
    return _Points(p, normals, _corners(net.grid, p), encoded, shading)


@torch.no_grad()
def _scale_correction(net: SurfaceNet, held_out: _Points) -> None:
    """Scale the net's correction of normals to its least error at points that it was not trained on.

    Facets finer than the grid cannot be learned: what the net takes of them is noise elsewhere.
    """
    features = net.grid.lookup(*held_out.corners)
    _, shading = net.albedo_and_normal(held_out.points, held_out.normals, features)
    correction, wanted = shading - held_out.normals, held_out.shading - held_out.normals
    factor = (correction * wanted).sum() / correction.square().sum().clamp(min=1e-12)
    for values in net.appearance[-1].parameters():
        values[3:] *= factor.clamp(0, 1)


@torch.no_grad()
def _gather(
    surface: Isosurface,
    net: SurfaceNet,
    baked: Baked,
    views: dict[str, np.ndarray],
    count: int,
    dark_share: float,
    rng: np.random.Generator,
) -> _Pixels:
    """Sample about ``count`` pixels, equally many per image; dark ones with lower probability."""
    share, parts = -(-count // len(views["rgba"])), []
    every, poses, parts_of = views["rgba"], views["camera_to_world"], image_intrinsics(views)
    for group in _same_light(views["light"]):
        light = views["light"][group[0]]
        image, rows, columns = np.nonzero(every[group, ..., 3] >= MIN_FOREGROUND_ALPHA)
        rays = []
        for k, i in enumerate(group):
            pixels = np.stack([columns[image == k], rows[image == k]], 1) + 0.5
            rays.append(camera_rays(poses[i], parts_of[i], pixels))
        origins, directions = (np.concatenate(each) for each in zip(*rays, strict=True))
        samples = trace(surface, origins, directions, light)
        ray = samples.ray.numpy()  # NumPy takes a tensor of one element for a number
        place = image[ray], rows[ray], columns[ray]
        state = np.zeros((len(group), *every.shape[1:3]), np.int8)
        state[place] = 1 + samples.lit.numpy()
        window = (1, 3, 3)
        chosen = np.flatnonzero((maximum_filter(state, window) == minimum_filter(state, window))[place])
        if not len(chosen):
            continue
        samples = samples.select(torch.from_numpy(chosen))
        l = torch.from_numpy(np.asarray(light, np.float32))
        base_color, normals = baked.look_of(samples)
        direct = net.direct(samples, l, base_color, normals)
        # Bright pixels are more informative. They are told by what is known of them: to choose by the
        # rendered pixel would prefer those with bright noise.
        expected = direct + base_color * baked.radiosity.gather(samples, l)
        chance = np.where(expected.amax(1).numpy() > DARK, 1, dark_share)
        picked = np.concatenate([_pick(own, chance, share, rng) for own in _split(image[ray[chosen]])])
        kept = torch.from_numpy(picked)
        samples = samples.select(kept)
        base_color, normals, direct = (take_rows(v, kept) for v in (base_color, normals, direct))
        gathered = baked.radiosity.gather(samples, l)
        mirrored = net.mirrored(baked, samples, l, base_color, normals)
        inputs = net.bounce_inputs(samples, l, normals, direct, gathered, mirrored)
        bounced = inputs.features.half(), inputs.gathered, inputs.mirrored
        seen = tuple(each[chosen[picked]] for each in place)
        target = every[group[0] : group[-1] + 1][seen][:, :3].astype(np.float32).clip(max=1)
        parts.append((*bounced, base_color, direct, torch.from_numpy(target), samples.points))
    if not parts:
        raise ObjectFolderError(
            f"none of {len(views['rgba'])} images shows a pixel well inside the object: "
            "check cameras, focal length and scale, or render at a higher resolution"
        )
    features, gathered, mirrored, base_color, direct, colors, points = (torch.cat(p) for p in zip(*parts))
    known = BounceInputs(features, gathered, mirrored)
    return _Pixels(known, base_color, direct, colors, _corners(net.transport, points))


def _same_light(lights: np.ndarray) -> list[np.ndarray]:
    """Return consecutive images with the same light, at most `_TOGETHER` of them, as indices."""
    changes = np.flatnonzero((np.diff(lights, axis=0) != 0).any(1)) + 1
    runs = np.split(np.arange(len(lights)), changes)
    return [run[start : start + _TOGETHER] for run in runs for start in range(0, len(run), _TOGETHER)]


def _split(groups: np.ndarray) -> list[np.ndarray]:
    """Return the positions of each number in an ascending array."""
    return np.split(np.arange(len(groups)), np.flatnonzero(np.diff(groups)) + 1)


def _pick(rows: np.ndarray, chance: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most ``count`` of some rows without repetition, by the relative chance of each row."""
    own = chance[rows]
    return rng.choice(rows, min(count, len(rows)), replace=False, p=own / own.sum())


def _corners(grid: HashGrid, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Precompute grid corners of points that are looked up in every epoch.

    Preallocated, because they take most of the memory.
    """
    width = 8 * len(grid.resolutions)
    rows = torch.empty(len(points), width, dtype=torch.int32)
    weights = torch.empty(len(points), width, dtype=torch.float16)
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        rows[part], weights[part] = grid.corners(in_cube(points[part]))
    return rows, weights
