"""Rows of the index of a release."""

MUG = {
    **{"key": "mug", "path": "objects/mug.safetensors", "category": "kitchen", "material": "ceramic"},
    **{"size": 0.112, "split": "train", "modes": 30, "lowest_hz": 1500.0, "vision_psnr": -3.5},
    **{"gain_error": 1e-05, "touch_psnr": None, "bytes": 1000, "sha256": "0" * 64},
    **{"licence": "CC0-1.0", "source": "=YCB, https://a.b", "licence_url": "https://c.d", "title": "025"},
    **{"attribution": "=A. Smith", "changes": "renamed", "uncertain": 1},
}
BELL = MUG | {"key": "bell", "path": "objects/bell.safetensors", "material": "steel"}
