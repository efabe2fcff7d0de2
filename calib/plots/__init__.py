"""Pictures of a recording, of a fit and of a gap, drawn by ``calib/drawing``.

The room knows its subjects by protocols: a recording, a fit and a gap report can therefore offer ``.plot()`` without a
circle of imports.
"""
