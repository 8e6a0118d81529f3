"""pack: three nets, sdf.npz, normalize.json, modal.json -> ObjectFile.safetensors."""

from objectfolder.io import file_digest, read_json, read_npz, read_safetensors
from objectfolder.objectfile.packing import pack
from objectfolder.workspace.layout import MODALITIES, Build
from stages import run


def main(key: str) -> None:
    build = Build(key)
    inputs = {"sdf": build.sdf, "normalize": build.normalize, **{m: build.net(m) for m in MODALITIES}}
    file = pack(
        key,
        read_json(build.modal),
        read_json(build.normalize),
        read_npz(build.sdf, "values", "band"),
        {modality: read_safetensors(build.net(modality)) for modality in MODALITIES},
        {name: file_digest(path) for name, path in inputs.items()},
    )
    file.save(build.object_file)


if __name__ == "__main__":
    run(main, __doc__)
