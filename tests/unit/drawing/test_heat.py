from __future__ import annotations

from xml.etree import ElementTree

from mavcal.calib.drawing.heat import heat


def test_names_of_conditions_have_room_above_the_map():
    name = "rotor speed of motor 4 118..120 Hz"
    root = ElementTree.fromstring(heat(["accel.x 1"], [name], [(0, 0, 1.0, "")], "map", colour="red"))
    turned = next(g for g in root.findall("g") if name in "".join(g.itertext()))
    y = float(turned.attrib["transform"].split("translate(")[1].split(")")[0].split()[1])
    assert y > 0.866 * 5.6 * len(name)


def test_a_cell_is_coloured_by_its_level_and_says_what_it_is() -> None:
    drawn = heat(["a"], ["b", "c"], [(0, 0, 0.0, "<none>"), (0, 1, 5.0, "all")], "map", colour="red")
    cells = list(ElementTree.fromstring(drawn).iter("rect"))
    assert [cell.attrib["fill-opacity"] for cell in cells] == ["0.12", "1.00"]
    assert [cell.findtext("title") for cell in cells] == ["<none>", "all"]
