from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from mavcal.calib.gap.schema import LocatedGap, Regime, SequenceStep, Shrink
from mavcal.calib.gap_report.table_plots import waterfall, where_map


def cell(kind, low, high, nats, channel="mag.x"):
    unit = {"band": "Hz", "time": "s", "all": ""}[kind]
    return LocatedGap(channel, 1, Regime(kind, (low, high), unit), nats, 0.5, "uT", 1e-9)


def table(*cells):
    """Rows and columns of a map by name, and its cells: (row, column) to strength and words."""
    root = ElementTree.fromstring(where_map(cells))
    groups = [group for group in root.findall("g") if "rotate" in group.attrib["transform"]]
    columns = ["".join(group.itertext()) for group in groups]
    rows = [e.text for e in root.findall("text")]
    drawn = {}
    for rect in root.findall("rect"):
        if rect.find("title") is None:
            continue
        j = round((float(rect.attrib["x"]) - 128.0) / 17.0)
        strength, words = float(rect.attrib["fill-opacity"]), rect.findtext("title")
        drawn[rows[_row(rect, root)], columns[j]] = strength, words
    return rows, columns, drawn


def _row(rect, root):
    tops = sorted({float(r.attrib["y"]) for r in root.findall("rect") if r.find("title") is not None})
    return tops.index(float(rect.attrib["y"]))


def test_regimes_stand_in_their_order_and_bands_by_frequency():
    cells = [
        *(cell("time", low, low + 10.0, 1.0) for low in (50.0, 0.0, 20.0)),
        *(cell("band", low, high, 1.0) for low, high in ((5.0, 25.0), (0.0, 1.0), (1.0, 5.0))),
    ]
    _, columns, _ = table(*cells)
    assert [column.split()[:2] for column in columns] == [
        ["time", "0..10"],
        ["time", "20..30"],
        ["time", "50..60"],
        ["band", "0..1"],
        ["band", "1..5"],
        ["band", "5..25"],
    ]


def test_the_stronger_the_gap_the_stronger_the_colour():
    rows, _, drawn = table(
        cell("all", 0.0, 1.0, 2.0), cell("all", 0.0, 1.0, 0.05, "mag.y"), cell("all", 0.0, 1.0, 1e-6, "mag.z")
    )
    assert rows == ["mag.x 1", "mag.y 1", "mag.z 1"]
    strengths = [drawn[row, "whole recording"][0] for row in rows]
    assert strengths[0] == 1.0
    assert strengths[2] == 0.12
    assert 0.12 < strengths[1] < 1.0


def test_of_two_findings_in_one_cell_the_stronger_is_shown():
    _, _, drawn = table(cell("time", 0.0, 10.0, 0.5), cell("time", 0.1, 10.1, 2.0), cell("time", 50.0, 60.0, 1.0))
    told = [words for _, words in drawn.values()]
    assert len(told) == 2
    assert any("2 nats a sample" in words for words in told)


def test_a_gap_that_is_faint_everywhere_is_drawn_all_the_same():
    _, _, drawn = table(cell("all", 0.0, 1.0, 1e-5))
    assert next(iter(drawn.values()))[0] == 1.0


def test_without_findings_there_is_no_map():
    assert where_map(()) == ""


SHRINK = Shrink(2.0, 0.5, 0.25, "declared_noise", 0.85, None, nested=True, sequence=(SequenceStep("gyro_bias", 0.8),))


def bars(shrink):
    root = ElementTree.fromstring(waterfall(shrink))
    names = [e.text for e in root.findall("text")]
    spans = [(float(r.attrib["x"]), float(r.attrib["width"])) for r in root.findall("rect")]
    return names, spans


def test_every_effect_takes_its_part_of_the_gap():
    names, spans = bars(SHRINK)
    assert names[::2] == ["without any effect", "with gyro_bias", "left over", "floor (declared noise)"]
    assert names[1::2] == ["2", "down to 0.6", "0.5", "0.25"]
    whole = spans[0][1]
    assert spans[1][1] == pytest.approx(whole * 0.8 * 1.75 / 2.0, abs=0.2)  # four fifths of what lies above the floor
    assert spans[1][0] + spans[1][1] == pytest.approx(spans[0][0] + whole, abs=0.2)
    assert spans[2][1] == pytest.approx(whole / 4.0, abs=0.2)


def test_a_bar_of_nothing_can_be_seen():
    _, spans = bars(replace(SHRINK, floor=0.0))
    assert spans[-1][1] == 1.5


def test_a_gap_below_zero_stays_in_the_picture():
    _, spans = bars(replace(SHRINK, after=-0.5, floor=-1.0))
    assert all(x >= 209.9 for x, _ in spans)


@pytest.mark.parametrize("change", [{"floor": 2.0}, {"floor": 3.0}, {"before": float("nan")}, {"floor": float("inf")}])
def test_without_a_gap_there_is_no_waterfall(change):
    assert waterfall(replace(SHRINK, **change)) == ""
