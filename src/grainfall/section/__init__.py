"""The section: a segmented image with its phases and pixel size, read from a file or synthesised."""

from grainfall.section.fetched import plane_of, read_known_volume
from grainfall.section.guess import guess_kind
from grainfall.section.read import Section, load_section, read_reference, read_section, write_section
from grainfall.section.resample import resample
from grainfall.section.synthetic import Mineral, Truth, synthesise
from grainfall.section.tomogram import Tomogram, simulate_tomogram

__all__ = [
    "Mineral",
    "Section",
    "Tomogram",
    "Truth",
    "guess_kind",
    "load_section",
    "plane_of",
    "read_known_volume",
    "read_reference",
    "read_section",
    "resample",
    "simulate_tomogram",
    "synthesise",
    "write_section",
]
