"""voxelize: surface.ply -> solid.npz (cut cells with sub-cell occupancy), sdf.npz (distance grid)."""

from objectfolder.artifacts import Build, write_npz
from objectfolder.fem.modal import adaptive_cut_cells
from objectfolder.mesh.sdf import check_resolved, distance_grid
from objectfolder.mesh.surface import read_surface
from objectfolder.params import stage_params
from stages import run


def main(key: str) -> None:
    section = stage_params("voxelize", key).section
    build = Build(key)
    vertices, faces = read_surface(build.surface)
    cells = adaptive_cut_cells(
        vertices, faces, section.resolutions, section.subdivisions, section.max_degrees_of_freedom
    )
    write_npz(build.solid, **vars(cells))
    values, band = distance_grid(vertices, faces, section.sdf_resolution)
    check_resolved(values, vertices, faces, key)
    write_npz(build.sdf, values=values, band=band)


if __name__ == "__main__":
    run(main, __doc__)
