"""The section: a segmented image with its phases and pixel size, read from a file."""

from grainfall.section.read import Section, load_section, read_reference, read_section, write_section

__all__ = ["Section", "load_section", "read_reference", "read_section", "write_section"]
