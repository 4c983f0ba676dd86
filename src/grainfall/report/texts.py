"""The words of every figure, in the report and in captions elsewhere, and of the validation cases."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import yaml

_CASES = Path(__file__).with_name("templates") / "validation.yaml"


def cases_in_words() -> dict[str, dict]:
    """Of each validation case, in the order of the page: title, done, differs (optional), figures."""
    return yaml.safe_load(_CASES.read_text(encoding="utf-8"))


def case_names() -> dict[str, str]:
    """What each validation case is called in short, such as Case 3c."""
    return {case: said["title"].partition(":")[0] for case, said in cases_in_words().items()}


class Text(NamedTuple):
    """What a figure says: title, category, caption, alternative text, and what to say without it."""

    title: str
    category: str
    caption: str
    alt: str
    absent: str


TEXTS = {
    "twin": Text(
        "The rock and its twin",
        "Twin",
        "The section, or as much of its middle as a slice of the twin shows, beside the twin's middle slice "
        "(z points up), at one scale; and the whole twin: its top and two of its sides. Slices of one rock "
        "differ in porosity, too.",
        "A window of the section, a slice of the twin of the same size, and the twin as a block, coloured by "
        "mineral; pores are white.",
        "The twin is not there yet.",
    ),
    "section": Text(
        "The section",
        "Section",
        "The input, and a window of it: every grain outlined (dotted where the image border cuts it: such "
        "grains leave the size statistics) and the largest circle inscribed in every pore.",
        "Left: the whole section, minerals in colours. Right: a window with grain outlines and pore circles.",
        "The section is not there yet.",
    ),
    "sizes": Text(
        "Sizes in 2D and in 3D",
        "Sizes",
        "Above: radii seen on the section, and on slices of the twin. Below: radii unfolded to 3D, the "
        "twin's own grains, and the truth where it is known. Number densities of all radii; the axis ends "
        "where 99.9 % of the section's are shown. With a bootstrap, the band holds 95 % of its "
        "resamples in each of the unfolding's own bins, which are narrower than those drawn: where single "
        "ones vary much it runs out of the picture.",
        "Histograms of grain radii by mineral and of pore-circle radii, on slices above and in 3D below.",
        "No sizes have been unfolded yet.",
    ),
    "gallery": Text(
        "Grains and their masks",
        "Grains",
        "Some of the 3D grains, each beside the three grain sections it was made from, as measured. They "
        "become its central sections (xy horizontal, xz, yz vertical), rotated and stretched to match. All "
        "are drawn to fill their boxes, whatever their size: r is the radius of the disc that has the area "
        "of the grain section that chose the size.",
        "A gallery of shaded 3D grains, each with three outlines of measured grain sections.",
        "The grain library is not there yet.",
    ),
    "packings": Text(
        "The two packings and the twin",
        "Packing",
        "The same vertical slice after the first packing (grains only), after the second (grains and virtual "
        "spheres), and of the finished twin, spheres removed. Gravity points down.",
        "Three vertical slices: first packing, second packing with virtual spheres, and the twin.",
        "The twin is not there yet.",
    ),
    "forces": Text(
        "What carries the grains",
        "Packing",
        "Left: contacts between grains in a slab two mean grains thick through the middle of the twin, seen "
        "from the side: lines join two centres, as thick as the force between them in the second packing, "
        "from a sixth of the mean to five times. Contacts that carry nothing are thin grey lines. Right: the "
        "forces of all contacts that carry, those of the margin around the twin among them, up to six times "
        "their mean; the share of larger ones stands in the corner.",
        "A network of lines between grain centres, thicker where the contact force is larger.",
        "The contacts have not been found yet.",
    ),
    "virtual": Text(
        "Virtual spheres",
        "Packing",
        "Left: pore-circle radii unfolded to 3D, of the section and of the first packing, weighted by "
        "volume, for equal numbers of spheres, over the section's total. Right: their difference, and the "
        "part of it above zero in the unfolding's own, narrower bins: the sizes that virtual spheres got, "
        "but for those that hold nothing open or do not fit. Bodies in the shapes of voids are poured "
        "smaller, so that their voids have these sizes. The axis ends where 99.9 % of either volume are "
        "shown.",
        "Histograms of pore-circle radii: target and first packing, their difference, and the sizes used.",
        "The sizes of virtual spheres have not been computed yet.",
    ),
    "s2": Text(
        "Two-point correlation",
        "Correlation",
        "Probability that two points a lag apart both lie in the solid. Left: slices of the twin, their mean "
        "and the section's. Right: global envelope of slices from all realizations; the test asks whether "
        "the section could be one of them. Both are seen in windows of one size, the largest that section "
        "and twin hold; of a larger section the middle window is tested, whose porosity may differ from the "
        "section's, and then every other one.",
        "S2 curves of slices of the twin with the section's curve, and the global envelope around it.",
        "S₂ has not been computed yet.",
    ),
    "network": Text(
        "Pore network",
        "Network",
        "Share of the pore volume in linked pores up to a radius, radii of throats, and throats per pore; "
        "twin against reference where there is one. What lies between the curves of pores is their "
        "distance W₁. "
        "Necks of a single voxel face are throats, too: the topology of the pore space is kept.",
        "Histograms of pore radii, throat radii and coordination of the pore network.",
        "The pore network has not been extracted, or has no pores.",
    ),
    "ensembles": Text(
        "Realizations and their means",
        "Comparison",
        "Ticks: single realizations. Dots: means, from three realizations on with 95 % intervals. Dashed: "
        "target or reference, shaded what counts as met.",
        "Realizations, means and intervals of every variant and engine, one panel per metric; the tables "
        "below have the numbers.",
        "One twin only: there is nothing to compare and no interval to give.",
    ),
}
"""The words of every figure, in the report and in captions elsewhere."""
