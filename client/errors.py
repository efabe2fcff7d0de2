"""What goes wrong when a service is asked.

.. code-block:: text

    ClientError
    +-- Unreachable          no answer came: the network, or the service is not there
    +-- UnexpectedAnswer     an answer came that is not from this service, or not of this version
    +-- ApiProblem           the service says no; one subclass for each code, in ``mavcal.client.problems``
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class ClientError(Exception):
    """Something went wrong while a service was asked."""


class Unreachable(ClientError):  # noqa: N818 - a name says what happened
    """No answer came: the network, or the service is not there."""


class UnexpectedAnswer(ClientError):  # noqa: N818 - a name says what happened
    """An answer came that is not from this service, or not of this version."""


class ApiProblem(ClientError):  # noqa: N818 - a name says what happened
    """The service answered with a problem document.

    `code` says to programs what kind of problem it is, `detail` to people what happened and what helps. `request_id`
    finds it in the log of the service. `problem` is the whole document.
    """

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        super().__init__(f"{status}: {problem.get('detail') or problem.get('title') or 'no detail'}")
        self.status = status
        self.code = str(problem.get("code", ""))
        self.detail = str(problem.get("detail", ""))
        self.request_id = str(problem.get("request_id", ""))
        self.problem = dict(problem)
