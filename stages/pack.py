"""pack: three nets, sdf.npz, normalize.json, material -> ObjectFile.safetensors."""

from objectfolder.io import file_digest, read_json, read_npz, read_safetensors
from objectfolder.objectfile.packing import pack
from objectfolder.workspace.layout import MODALITIES, Build
from objectfolder.workspace.params import stage_params
from stages import run


def main(key: str) -> None:
    params = stage_params("pack", key)
    build = Build(key)
    inputs = {"sdf": build.sdf, "normalize": build.normalize, **{m: build.net(m) for m in MODALITIES}}
    file = pack(
        key,
        params.object.material,
        read_json(build.normalize),
        read_npz(build.sdf, "values", "band"),
        {modality: read_safetensors(build.net(modality)) for modality in MODALITIES},
        {name: file_digest(path) for name, path in inputs.items()},
    )
    file.save(build.object_file)


if __name__ == "__main__":
    run(main, __doc__)
