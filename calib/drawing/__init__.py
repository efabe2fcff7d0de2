"""Pictures as SVG: charts, maps of colours and of directions. Small, diffable, and good inside a page or as a file."""

from mavcal.calib.drawing.chart import Chart
from mavcal.calib.drawing.heat import heat
from mavcal.calib.drawing.legend import Key
from mavcal.calib.drawing.picture import Blank, Drawing, Picture, sheet, side_by_side, svg, text
from mavcal.calib.drawing.scale import limits_of, thinned
from mavcal.calib.drawing.space import SpaceView, SphereMap

__all__ = [
    "Blank",
    "Chart",
    "Drawing",
    "Key",
    "Picture",
    "SpaceView",
    "SphereMap",
    "heat",
    "limits_of",
    "sheet",
    "side_by_side",
    "svg",
    "text",
    "thinned",
]
