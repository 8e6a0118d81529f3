"""What a release says to people: facts of its objects in words, for its card, datasheet and metadata."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from statistics import median

from objectfolder.objectfile.dataset import IndexEntry

_PAPER = (
    "R. Gao, Y.-Y. Chang, S. Mall, L. Fei-Fei, J. Wu. ObjectFolder: A Dataset of Objects with Implicit "
    "Visual, Auditory, and Tactile Representations. CoRL, 2021."
)


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
    keywords: Sequence[str] = field(
        default=("multisensory", "3D objects", "impact sound", "touch", "implicit representation", "robotics")
    )
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


def described(
    entries: Sequence[IndexEntry], *, name: str, creator: str, version: str, date: str, url: str
) -> Words:
    """Describe a release."""
    sizes = sorted(entry.size for entry in entries)
    summary = (
        f"{len(entries)} Object Files: implicit representations that answer how an object looks from any "
        "camera under any light, how it sounds when struck anywhere, and what a tactile sensor feels "
        f"anywhere on it. Materials: {counted(entry.material for entry in entries)}. "
        f"Sizes: {sizes[0]:.2g} to {sizes[-1]:.2g} m."
    )
    return Words(name=name, summary=summary, creator=creator, version=version, date=date, url=url)


def counted(values: Iterable[str]) -> str:
    """List values with how often each occurs, the most frequent first."""
    ordered = sorted(Counter(values).items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{value or 'other'} {count}" for value, count in ordered)


def spread(values: Sequence[float | None]) -> str:
    """Return median and extremes of those that are known."""
    known = sorted(value for value in values if value is not None)
    if not known:
        return "unknown"
    middle, least, most = (f"{float(f'{value:.3g}'):,g}" for value in (median(known), known[0], known[-1]))
    return f"{middle} ({least} to {most})"
