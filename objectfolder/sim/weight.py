"""The mass of an object, how sure it is, and whether a solid of its material is too heavy to be one."""

from dataclasses import asdict, dataclass
from typing import Any

from objectfolder.base.materials import Material


@dataclass(frozen=True)
class UsualMake:
    """How things of a material are made."""

    densities: tuple[float, float]  #: least and greatest of what is sold by the material's name, kg/m^3
    wall: float  #: usual wall of hollow things, m
    thickest: float  #: beyond it, m, few things are solid


#: By the material's name. Densities: ranges of handbooks (polypropylene to PVC, soft to hard wood,
#: earthenware to porcelain, cast to wrought iron). Walls and thickest sections: design rules of injection
#: moulding (1 to 4 mm; thicker parts sink and warp), of ceramics (thicker bodies crack in the kiln) and of
#: glassware; sheet for steel, castings for iron; wood is sawn. They are rules of thumb, for warnings.
USUAL = {
    "ceramic": UsualMake((1900, 2800), 0.005, 0.025),
    "glass": UsualMake((2400, 2900), 0.003, 0.025),
    "iron": UsualMake((6900, 8000), 0.004, 0.04),
    "plastic": UsualMake((900, 1400), 0.002, 0.015),
    "polycarbonate": UsualMake((1180, 1220), 0.002, 0.015),
    "steel": UsualMake((7700, 8050), 0.001, 0.02),
    "wood": UsualMake((350, 950), 0.012, 0.12),
}


@dataclass(frozen=True)
class Weight:
    """Mass of an object, where it is from, and between what it may lie."""

    kg: float
    source: str  #: given, shell (hollow, with a given wall) or solid
    low: float  #: kg
    high: float  #: kg
    density: float  #: of the material, kg/m^3
    volume: float  #: of the material, m^3
    shell: float | None  #: wall of a hollow one, m
    thickest: float  #: diameter of the largest ball inside, m
    warning: str = ""  #: why the mass is not plausible

    def report(self) -> dict[str, Any]:
        """Return what ``asset.json`` says of it."""
        return asdict(self)

    def __str__(self) -> str:
        hollow = f"hollow with a wall of {_mm(self.shell)}" if self.shell else "solid"
        if self.source == "given":
            return f"{self.kg:.4g} kg, given; inertia as if evenly filled and {hollow}"
        made = f"{hollow}, {self.volume * 1e6:.4g} cm3 at {self.density:g} kg/m3"
        return f"{self.kg:.4g} kg: {made}; between {self.low:.3g} and {self.high:.3g} kg"


def judge_weight(
    material: Material, volume: float, area: float, thickest: float, shell: float | None, given: float | None
) -> Weight:
    """Return the mass of an object, and a warning if it is too heavy for what it looks like.

    A solid is too heavy if it is thicker than things of its material are made solid: a closed bottle of
    plastic. It may weigh as little as a hollow one of a quarter of the usual wall.

    Parameters
    ----------
    material : Material
    volume, area : float
        Of the material, m^3, and of the object's outer surface, m^2.
    thickest : float
        Diameter of the largest ball inside the outer surface, m.
    shell : float, optional
        Wall of a hollow object, m.
    given : float, optional
        Known mass, kg.
    """

    def weight(kg: float, source: str, low: float, high: float, warning: str = "") -> Weight:
        return Weight(kg, source, low, high, material.density, volume, shell, thickest, warning)

    kg, source = material.density * volume, "shell" if shell else "solid"
    if given is not None:
        return weight(given, "given", given, given)
    usual = USUAL.get(material.name.lower())
    if usual is None:
        return weight(kg, source, kg, kg)
    lightest, densest = min(usual.densities[0], material.density), max(usual.densities[1], material.density)
    if shell or thickest <= usual.thickest:
        return weight(kg, source, lightest * volume, densest * volume)
    hollow = min(area * usual.wall, volume)
    warning = (
        f"it is {thickest * 1000:.3g} mm thick, and {material.name} is seldom solid beyond "
        f"{_mm(usual.thickest)}: solid it weighs {kg:.3g} kg, hollow with a wall of {_mm(usual.wall)} about "
        f"{material.density * hollow:.2g} kg; give --mass KG if you know it, or --shell {1000 * usual.wall:g}"
    )
    # Of thin bottles and cans, and of vessels, of which both sides count: a quarter of the usual wall.
    return weight(kg, source, lightest * hollow / 4, densest * volume, warning)


def _mm(metres: float | None) -> str:
    return f"{1000 * (metres or 0):g} mm"
