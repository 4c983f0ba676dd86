"""grainfall: one segmented 2D section in, physically packed 3D digital twins out.

The chapters of the method are the modules of this package, in reading order: section, morphology,
stereology, grains, packing, volume, correlation, network, flow, contacts, export, report; ``cli`` is last. A
later chapter may import an earlier one, never the reverse; ``units``, ``io``, ``random`` and ``errors`` are
shared ground.
"""

__version__ = "0.1.0"
