"""modal: solid, surface, material, scale -> modes.npz, modal.json."""

from contextlib import suppress

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest, keep, write_json
from objectfolder.base.materials import own_material
from objectfolder.base.seeding import numpy_generator
from objectfolder.base.text import visible
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.sampling import split_rows
from objectfolder.sound.fem.certainty import is_uncertain, solver_warning, uncertainty_warning
from objectfolder.sound.fem.elements import solid_from_arrays
from objectfolder.sound.fem.modal import Request, refined_analysis, shape_points
from objectfolder.sound.fem.settings import ModalConfig
from objectfolder.sound.truth import compute_modes, problem_digest
from objectfolder.workspace.code_digests import code_digest
from objectfolder.workspace.layout import Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params(ModalConfig, key)
    build, settings = Build(key), params.settings
    rng = numpy_generator(params.seed, key, "modal")
    points = shape_points(*read_surface(build.surface), settings.surface_points, rng)
    material = own_material(params.entry.material, settings.damping)
    request = Request(material, params.entry.scale, settings.max_frequency, settings.max_modes)
    solid, surface = solid_from_arrays(read_npz(build.solid, "kind")), read_surface(build.solid_surface)
    files = map(file_digest, (build.solid, build.solid_surface))
    problem = problem_digest(files, code_digest(refined_analysis), points, material.poisson_ratio, settings)
    earlier = None
    with suppress(ObjectFolderError):  # no earlier solve, or not a readable one
        earlier = read_npz(build.solved_modes, "solution", "band_hz")
    modes, report = compute_modes(solid, surface, points, request, settings.fine, problem, earlier, key)
    if is_uncertain(report) and not settings.allow_uncertain:
        report |= {"uncertain": True}
    for warning in filter(None, (uncertainty_warning(report, key), solver_warning(report, key))):
        print(f"warning: {visible(warning)}")
    write_npz(build.modes, points=points, split=split_rows(len(points), rng), **modes)
    if not report["reused"]:
        keep(build.modes, build.solved_modes)
    write_json(build.modal, report)


if __name__ == "__main__":
    run(main, __doc__)
