"""A gap report for people: the verdict in words, and one self-contained page with the pictures."""

from mavcal.calib.gap_report.page import gap_to_html
from mavcal.calib.gap_report.words import verdict_sentence

__all__ = ["gap_to_html", "verdict_sentence"]
