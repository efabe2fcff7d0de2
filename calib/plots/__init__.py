"""Pictures of a recording, of a fit and of a gap, drawn by ``calib/drawing``.

The package knows its subjects by protocols, so that recording, fit and gap report can offer ``.plot()`` without
circular imports.
"""
