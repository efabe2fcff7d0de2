"""Work on untrusted files, in child processes that can be limited and ended.

A *fork server* is one small process, started when it is first needed. It has imported what reading, fitting and
diagnosing need, and forks a child for each order. The child sets its own limits, does one task, writes its result as
JSON and ends. Only the fork server's pipes connect it to the service. When the service ends, the fork server sees its
input close and kills its children. A child dies with the fork server.
"""

from mavcal.service.children.limits import Limits
from mavcal.service.children.pool import Children, Runs
from mavcal.service.children.tasks import DIAGNOSE, FIT, INSPECT, SERIES

__all__ = ["DIAGNOSE", "FIT", "INSPECT", "SERIES", "Children", "Limits", "Runs"]
