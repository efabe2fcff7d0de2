"""Colours of the report's pictures: variables of its style sheet, which has them for light, dark and paper."""

BEFORE, AFTER, MODEL, FLOOR = "var(--before)", "var(--after)", "var(--model)", "var(--floor)"
