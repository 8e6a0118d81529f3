"""modal: solid, surface, material, scale -> modes.npz, modal.json."""

import numpy as np

from objectfolder.artifacts import Build, read_npz, write_json, write_npz
from objectfolder.fem.cutcell import CutCells
from objectfolder.fem.modal import modal_analysis
from objectfolder.materials import material
from objectfolder.mesh.ply import read_surface
from objectfolder.mesh.sampling import sample_surface, split_rows
from objectfolder.params import stage_params
from objectfolder.seeding import numpy_generator
from stages import run


def main(key: str) -> None:
    params = stage_params("modal", key)
    build, section = Build(key), params.section
    vertices, faces = read_surface(build.surface)
    cells = CutCells.from_arrays(read_npz(build.solid, "index", "occupancy"))
    rng = numpy_generator(params.seed, key, "modal")
    points = np.concatenate([vertices, sample_surface(vertices, faces, section.surface_points, rng)])
    data = modal_analysis(
        cells,
        points,
        material(params.object.material),
        params.object.scale,
        section.max_frequency,
        section.max_modes,
        key,
    )
    write_npz(
        build.modes,
        points=points,
        split=split_rows(len(points), rng),
        **data.arrays(),
        truncated=data.report["truncated"],
    )
    write_json(build.modal, data.report)


if __name__ == "__main__":
    run(main, __doc__)
