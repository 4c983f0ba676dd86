"""grainfall: one segmented 2D section in, physically packed 3D digital twins out.

The chapters of the method are the modules of this package, in reading order: section, morphology,
stereology, grains, packing, volume, correlation, network, flow, contacts, export, report. What stands beside
the method: ``size_bias`` and ``accuracy`` are studies of it, ``cli`` is its command line. A later chapter may
import an earlier one, never the reverse; all others (``config``, ``io``, ``units``, ...) are shared ground.
"""

__version__ = "0.1.0"
