"""Friction of objects against elastomers."""

#: Coefficients of dry sliding friction by material, against a table or a silicone elastomer. Assumed:
#: handbooks give ranges of +-0.1 and more, and the friction of an elastomer depends on load and wear.
FRICTION = {
    "ceramic": 0.5,
    "glass": 0.5,
    "wood": 0.6,
    "plastic": 0.5,
    "iron": 0.45,
    "polycarbonate": 0.5,
    "steel": 0.45,
}
_OTHER_FRICTION = 0.5  # of custom materials


def friction_of(material: str) -> float:
    """Return the coefficient of a material's name, in any case; that of unknown ones is 0.5."""
    return FRICTION.get(material.lower(), _OTHER_FRICTION)
