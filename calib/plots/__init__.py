"""Figures of matplotlib (the extra ``mavcal[plot]``), which is loaded when one is drawn.

A figure belongs to no window and no back end: save it, or show it in a notebook. The room knows its subjects by
protocols. A recording, a fit and a gap report can therefore offer ``.plot()`` without a circle of imports.
"""
