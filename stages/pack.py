"""pack: nets, radiation.safetensors, sdf.npz, normalize.json, modal.json, mass -> ObjectFile.safetensors."""

from objectfolder.base.arrays import read_npz, read_safetensors, write_safetensors
from objectfolder.base.io import file_digest, read_json
from objectfolder.objectfile.packing import pack_object_file
from objectfolder.workspace.layout import MODALITIES, Build
from objectfolder.workspace.params import object_entry, read
from stages import run


def main(key: str) -> None:
    build = Build(key)
    inputs = {"sdf": build.sdf, "normalize": build.normalize, **{m: build.net(m) for m in MODALITIES}}
    inputs["radiation"] = build.radiation
    header, tensors = pack_object_file(
        key,
        read_json(build.modal),
        read_json(build.normalize),
        read_npz(build.sdf, "values", "band"),
        {modality: read_safetensors(build.net(modality)) for modality in MODALITIES},
        {name: file_digest(path) for name, path in inputs.items()},
        read_safetensors(build.radiation),
        object_entry(key, read()).mass,
    )
    write_safetensors(build.object_file, tensors, header)


if __name__ == "__main__":
    run(main, __doc__)
