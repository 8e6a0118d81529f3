"""README.md, a dataset card of the Hugging Face Hub, and DATASHEET.md of a release, and their words."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from objectfolder.base.errors import plural
from objectfolder.base.text import in_markdown
from objectfolder.base.yamlfile import yaml_text
from objectfolder.hub.release.notices import Notice, attributions, hub_licence
from objectfolder.objectfile.dataset import INDEX, OBJECTS, IndexEntry

_PAPER = (
    "R. Gao, Y.-Y. Chang, S. Mall, L. Fei-Fei, J. Wu. ObjectFolder: A Dataset of Objects with Implicit "
    "Visual, Auditory, and Tactile Representations. CoRL, 2021."
)
_KEYWORDS = ("multisensory", "3D objects", "impact sound", "touch", "implicit representation", "robotics")
LICENCES = "licences"  #: folder of the notices
_ATTRIBUTION = (
    "Name these with what you make from the objects; the Object Files were made from their meshes. "
    f"{INDEX} has title and page of each."
)
_INSTANCE = "An instance is one object; none is missing a label: the material is given."
_PREPROCESSING = (
    "Meshes were scaled to their size and closed to solids; small gaps between bodies may be filled."
)
_SITE = "\n\n[site/index.html](site/index.html) shows every object: see, strike and touch it in a browser."


@dataclass(frozen=True, kw_only=True)
class Words:
    """Texts about a release; those with defaults hold for every release."""

    name: str
    summary: str
    creator: str
    version: str
    date: str  #: YYYY-MM-DD
    url: str
    citation: str = _PAPER
    keywords: Sequence[str] = _KEYWORDS
    making: str = (
        "Simulated from textured meshes by objectfolder: views by path tracing, vibration modes by finite "
        "elements, tactile images by contact with an elastic gel. Nets and a distance grid were fitted to "
        "that and stored."
    )
    limits: str = (
        "Views, sounds and touches are simulated, none is of a real object; textures of scanned meshes are "
        "photographs. Each object is one uniform, linear, elastic solid without joints, liquids or coatings. "
        "Damping is a law of its material, not a measurement of the object. Tactile images are those of the "
        "sensor that each file names."
    )
    biases: str = (
        "Objects were chosen because a mesh was at hand or could be generated: they are no sample of any "
        "household. Sizes, materials and categories are distributed as the card says."
    )
    uses: str = (
        "Research on perception and manipulation with sight, sound and touch: recognition, retrieval, "
        "reconstruction, grasping, simulation. Not meant: certifying what a real object sounds or feels like."
    )
    impact: str = (
        "Models that are trained on simulated objects alone may fail on real ones; test them on real data."
    )
    personal: str = "None: objects only, no people."
    maintenance: str = (
        "A new version is a new release with its own version number; files are never changed in place."
    )


def describe_release(
    entries: Sequence[IndexEntry], *, name: str, creator: str, version: str, date: str, url: str
) -> Words:
    """Describe a release."""
    sizes = sorted(entry.size for entry in entries)
    summary = (
        f"{plural(len(entries), 'Object File')}, each an implicit representation that answers how an object "
        "looks from any camera under any light, how it sounds when struck anywhere, and what a tactile "
        f"sensor feels anywhere on it. Materials: {count_values(entry.material for entry in entries)}. "
        f"Sizes: {sizes[0]:.2g} to {sizes[-1]:.2g} m."
    )
    return Words(name=name, summary=summary, creator=creator, version=version, date=date, url=url)


def count_values(values: Iterable[str]) -> str:
    """List values with how often each occurs, the most frequent first."""
    ordered = sorted(Counter(values).items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{value or 'other'} {count}" for value, count in ordered)


def summarize(values: Sequence[float | None]) -> str:
    """Return median and extremes of those that are known."""
    known = sorted(value for value in values if value is not None)
    if not known:
        return "unknown"
    middle, least, most = (f"{float(f'{value:.3g}'):,g}" for value in (median(known), known[0], known[-1]))
    return f"{middle} ({least} to {most})"


def card(entries: Sequence[IndexEntry], words: Words, notices: Mapping[str, Notice], site: bool) -> str:
    """Return README.md: what the release is and how to load it, with the Hub's metadata."""
    named = attributions(entries)
    attribution = f"## Attribution\n\n{_ATTRIBUTION}\n\n{named}\n\n" if named else ""
    copies = f"| `{LICENCES}/` | where each mesh is from: licence, authors, changes |\n" if notices else ""
    metadata = {
        "pretty_name": words.name,
        "license": hub_licence({entry.licence for entry in entries}),
        "tags": ["multisensory", "robotics", "3d", "audio", "tactile", "safetensors"],
        "size_categories": [_size_category(len(entries))],
        "configs": [{"config_name": "default", "data_files": [{"split": "objects", "path": INDEX}]}],
    }
    return f"""---
{yaml_text(metadata, "pretty_name")}---

# {in_markdown(words.name)}

{words.summary}{_SITE if site else ""}

Version {words.version}, {words.date}, by {in_markdown(words.creator)}.
Licences: {_count(entry.licence for entry in entries)}; {INDEX} gives that of each object.

## Load it

```python
from objectfolder import Dataset  # pip install CLONE, a clone of the repository of objectfolder

dataset = Dataset(".")  # this folder
for entry in dataset.filter(material={json.dumps(entries[0].material)}).entries:
    print(entry.key, entry.size, "m")
item = dataset[{json.dumps(entries[0].key)}]
image = item.view([2.0, 1.0, 1.2], lights="studio")
sound = item.impact(item.sample_surface(1), [0, 0, 0.02])
touch = item.touch(item.sample_surface(1), depth=0.001)
```

`datasets.load_dataset(FOLDER)` of Hugging Face gives the index. `sha256sum -c SHA256SUMS` checks the files.

## What is in it

| | |
|---|---|
| `{OBJECTS}/` | an Object File per object, {sum(entry.bytes for entry in entries) / 1e6:.1f} MB in all |
| `{INDEX}` | a row per object: category, material, size, split, scores, digest, licence, authors |
{copies}| `croissant.json` | metadata of Croissant 1.1 |
| `DATASHEET.md` | how it was made, what it is for, what it is not for |

| objects | median (least to most) |
|---|---|
| longest side, m | {summarize([entry.size for entry in entries])} |
| modes | {summarize([entry.modes for entry in entries])} |
| lowest mode, Hz | {summarize([entry.lowest_hz for entry in entries])} |
| PSNR of held-out views, dB | {summarize([entry.vision_psnr for entry in entries])} |
| error of gains at held-out points | {summarize([entry.gain_error for entry in entries])} |
| PSNR of held-out touches, dB | {summarize([entry.touch_psnr for entry in entries])} |

Categories: {_count(entry.category for entry in entries)}.
Materials: {_count(entry.material for entry in entries)}.
Split by object, for tests on unseen objects: {count_values(entry.split for entry in entries)}.

{attribution}## Cite

{words.citation}
"""


def datasheet(entries: Sequence[IndexEntry], words: Words) -> str:
    """Return DATASHEET.md, after Gebru et al., Datasheets for Datasets, 2021."""
    named = attributions(entries)
    attribution = f" {_ATTRIBUTION}\n\n{named}" if named else ""
    sources = _count(entry.source or "not stated" for entry in entries)
    licences = _count(entry.licence for entry in entries)
    splits = count_values(entry.split for entry in entries)
    answers = (
        ("Motivation", words.uses),
        ("Composition", f"{words.summary} {_INSTANCE}"),
        ("Collection", f"{words.making} Meshes: {sources}."),
        ("Preprocessing", _PREPROCESSING),
        ("Splits", f"By object: {splits}. Scores are of held-out data."),
        ("Limits", words.limits),
        ("Biases", words.biases),
        ("Personal data", words.personal),
        ("Social impact", words.impact),
        ("Distribution", f"Licences: {licences}. Each object has that of its mesh.{attribution}"),
        ("Maintenance", f"{words.maintenance} By {in_markdown(words.creator)}."),
    )
    sections = "\n".join(f"## {title}\n\n{text}\n" for title, text in answers)
    return f"# Datasheet of {in_markdown(words.name)}, version {words.version}\n\n{sections}"


def _count(values: Iterable[str]) -> str:
    return count_values(map(in_markdown, values))


def _size_category(count: int) -> str:
    limits = {"n<1K": 1e3, "1K<n<10K": 1e4, "10K<n<100K": 1e5, "100K<n<1M": 1e6}
    return next((name for name, limit in limits.items() if count < limit), "1M<n<10M")
