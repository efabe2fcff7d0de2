"""Pages of HTML from templates beside the modules that fill them; whatever is put in is escaped."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


def page(package: str, template: str, /, **values: Any) -> str:
    """The page of `template`, a file of the folder ``templates`` in `package`.

    Every value is escaped as it is put in, except :class:`markupsafe.Markup`: the pictures that we draw ourselves.
    A name that the template uses and `values` lack is an error, never an empty place.
    """
    return _templates(package).get_template(template).render(values)


@cache
def _templates(package: str) -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # not at a start of the service: it costs .1 s

    return Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
