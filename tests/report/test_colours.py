"""The colours of variants can be distinguished under all colour vision, on both grounds."""

from __future__ import annotations

import itertools
import re
from importlib.resources import files

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[np.float64]

STYLE = files("congelation.report").joinpath("report.css").read_text("utf-8")
GROUNDS = re.findall(r"--ground: (#[0-9a-f]{6})", STYLE)[:2]
PALETTES = [
    re.findall(r"--v[0-7]: (#[0-9a-f]{6})", part)
    for part in STYLE.split("@media screen and (prefers-color-scheme: dark)")
]

# G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, A Physiologically-based Model for Simulation of
# Color Vision Deficiency, IEEE Trans. Vis. Comput. Graph. 15(6), 2009: linear RGB, full severity.
VISIONS = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
         [0.004733, 0.691367, 0.303900]]
    ),
}  # fmt: skip
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
     [0.0193339, 0.1191920, 0.9503041]]
)  # fmt: skip
WHITE = np.array([0.95047, 1.0, 1.08883])  # D65


def linear(colour: str) -> Array:
    """An sRGB colour as linear RGB."""
    v = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


def lab(rgb: Array) -> Array:
    """Linear RGB in CIE L*a*b*, where equal distances look about equally large."""
    ratios = XYZ @ np.clip(rgb, 0.0, 1.0) / WHITE
    f = np.where(ratios > 0.008856, np.cbrt(ratios), 7.787 * ratios + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("palette", PALETTES, ids=["light", "dark"])
def test_any_two_variants_are_told_apart(palette: list[str], vision: str) -> None:
    """A distance of 2.3 can just be seen side by side."""
    assert len(palette) == 8
    seen = [lab(VISIONS[vision] @ linear(colour)) for colour in palette]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 15.0


@pytest.mark.parametrize(("palette", "ground"), [*zip(PALETTES, GROUNDS, strict=True)])
def test_a_curve_stands_out_of_its_ground(palette: list[str], ground: str) -> None:
    """WCAG 2.2, criterion 1.4.11: a contrast of 3 for what a graphic is understood by."""
    for colour in palette:
        dark, light = sorted(float(XYZ[1] @ linear(c)) for c in (colour, ground))
        assert (light + 0.05) / (dark + 0.05) > 3.0, colour
