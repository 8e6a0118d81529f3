"""Croissant 1.1 metadata of a release, with the fields of its vocabulary for responsible AI.

The format is MLCommons' (https://docs.mlcommons.org/croissant/); mlcroissant validates it in the tests.
"""

from collections.abc import Sequence
from typing import Any

from objectfolder.hub.release.pages import Words
from objectfolder.objectfile.dataset import COLUMNS, INDEX, OBJECTS, IndexEntry

CONFORMS_TO = ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"]
_TERMS = (
    *("arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field"),
    *("fileProperty", "fileObject", "fileSet", "format", "includes", "isArray", "isLiveDataset"),
    *("jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex", "repeated"),
    *("replace", "samplingRate", "separator", "source", "subField", "transform"),
)
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "description": {"@container": "@language"},
    "name": {"@container": "@language"},
    **{term: f"cr:{term}" for term in _TERMS},
}
_BYTES = "application/octet-stream"
_TYPES = {str: "sc:Text", int: "sc:Integer", float: "sc:Float"}
_MEANINGS = {
    "key": "Name of the object.",
    "path": "Object File, from the folder of the release.",
    "category": "Kind of object; empty if unknown.",
    "material": "Material.",
    "size": "Longest side, metres.",
    "split": "Part in benchmarks on unseen objects: train, val or test.",
    "modes": "Number of vibration modes that are stored.",
    "lowest_hz": "Frequency of the lowest of them, Hz.",
    "vision_psnr": "Mean PSNR of held-out views, dB.",
    "gain_error": "Energy-weighted relative error of gains at held-out points.",
    "touch_psnr": "PSNR of held-out tactile images, dB.",
    "bytes": "Size of the Object File.",
    "sha256": "Digest of the Object File.",
    "licence": "Licence of the mesh, and so of the Object File.",
    "source": "Where the mesh is from.",
    "licence_url": "Address of the licence; empty if unknown.",
    "title": "Name of the mesh at its source.",
    "attribution": "Whom to name with what is made from the Object File.",
    "changes": "What was changed of the published mesh.",
    "uncertain": "1 if the sound is marked uncertain, else 0.",
}


def croissant(entries: Sequence[IndexEntry], words: Words, index_digest: str) -> dict[str, Any]:
    """Return the metadata as JSON-LD; ``index_digest``: SHA-256 of the index."""
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": CONFORMS_TO,
        "name": words.name,
        "description": words.summary,
        "version": words.version,
        "license": sorted({_licence(entry) for entry in entries}),
        "creator": [{"@type": "sc:Person", "name": words.creator}],
        "datePublished": words.date,
        "url": words.url,
        "citeAs": words.citation,
        "keywords": list(words.keywords),
        "isLiveDataset": False,
        "distribution": [
            _file("index", INDEX, INDEX, "text/csv", index_digest),
            *(
                _file(_file_id(entry), entry.key, entry.path, _BYTES, entry.sha256)
                | {"contentSize": f"{entry.bytes} B", "license": _licence(entry)}
                | ({"creditText": entry.attribution} if entry.attribution else {})
                for entry in entries
            ),
            {
                "@type": "cr:FileSet",
                "@id": OBJECTS,
                "name": OBJECTS,
                "description": "Object Files, safetensors.",
                "containedIn": [{"@id": _file_id(entry)} for entry in entries],
                "encodingFormat": _BYTES,
                "includes": f"{OBJECTS}/*.safetensors",
            },
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "entries",
                "name": "entries",
                "description": "A row per object.",
                "key": {"@id": "entries/key"},
                "field": [_field(name, kind) for name, kind in COLUMNS.items()],
            }
        ],
        "rai:dataCollection": words.making,
        "rai:dataCollectionType": "Simulation",
        "rai:dataLimitations": words.limits,
        "rai:dataBiases": words.biases,
        "rai:dataUseCases": words.uses,
        "rai:dataSocialImpact": words.impact,
        "rai:personalSensitiveInformation": words.personal,
        "rai:dataReleaseMaintenancePlan": words.maintenance,
    }


def _file(identity: str, name: str, path: str, encoding: str, digest: str) -> dict[str, Any]:
    described = {"@type": "cr:FileObject", "@id": identity, "name": name, "contentUrl": path}
    return described | {"encodingFormat": encoding, "sha256": digest}


def _licence(entry: IndexEntry) -> str:
    """Return the address, as Croissant recommends; else the name."""
    return entry.licence_url or entry.licence


def _file_id(entry: IndexEntry) -> str:
    """Return an id that is none of the other nodes', whatever the key is."""
    return f"{OBJECTS}/{entry.key}"


def _field(name: str, kind: type) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"entries/{name}",
        "name": name,
        "description": _MEANINGS[name],
        "dataType": _TYPES[kind],
        "source": {"fileObject": {"@id": "index"}, "extract": {"column": name}},
    }
