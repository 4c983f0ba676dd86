"""The section: a segmented image with its phases and pixel size, read from a file or synthesised.

What makes rocks and tomograms up, or guesses, is loaded when it is asked for.
"""

from grainfall.section.fetched import keep_published, plane_of, published_file, read_known_volume
from grainfall.section.read import Section, load_section, read_reference, read_section, write_section
from grainfall.section.resample import resample

__all__ = [
    "Mineral",
    "Section",
    "Tomogram",
    "Truth",
    "guess_kind",
    "keep_published",
    "load_section",
    "plane_of",
    "published_file",
    "read_known_volume",
    "read_reference",
    "read_section",
    "resample",
    "simulate_tomogram",
    "stated_pixel_um",
    "synthesise",
    "write_section",
]


def __getattr__(name: str):
    # written out, not by lazy_loader: the graph of imports, by which edits rerun jobs, must see these
    if name in ("guess_kind", "stated_pixel_um"):
        import grainfall.section.guess as late
    elif name in ("Mineral", "Truth", "synthesise"):
        import grainfall.section.synthetic as late
    elif name in ("Tomogram", "simulate_tomogram"):
        import grainfall.section.tomogram as late
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(late, name)
