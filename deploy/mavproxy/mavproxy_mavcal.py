"""MAVProxy: starts calibrations of a mavcal service and speaks their prompts.

Install mavcal into MAVProxy's Python, and name the folder of this file when you start MAVProxy:

    PYTHONPATH=deploy/mavproxy mavproxy.py --master=udpin:127.0.0.1:14550

Then at its prompt (the module has the name of the file: `mavcal` alone is the package that it uses):

    module load mavproxy_mavcal
    mavcal url http://127.0.0.1:8765   # the service; set MAVCAL_API_KEY where it asks for a key
    mavcal start mag                   # gyro, accel, mag, thermal, level ...
    mavcal answer finish
    mavcal accept                      # writes the plan that waits in review
    mavcal cancel | mavcal status
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any

from MAVProxy.modules.lib import mp_module

from mavcal.client import ApiProblem, Client, Unreachable
from mavcal.client.enums import JobState
from mavcal.client.events import PromptEvent, StateEvent

DEFAULT_URL = "http://127.0.0.1:8765"
VERBS = ("url", "start", "answer", "accept", "cancel", "status")
OVER = {JobState.SUCCEEDED, JobState.REVERTED, JobState.FAILED, JobState.CANCELLED, JobState.INTERRUPTED}


class MavcalModule(mp_module.MPModule):
    """The command `mavcal` of MAVProxy."""

    def __init__(self, mpstate: Any) -> None:
        super().__init__(mpstate, "mavcal", "calibration with mavcal", public=True)
        self._url = os.environ.get("MAVCAL_URL", DEFAULT_URL)
        self._job = ""
        self._told: queue.Queue[str] = queue.Queue()
        self.add_command("mavcal", self.cmd_mavcal, "calibrate sensors", list(VERBS))

    def cmd_mavcal(self, args: Sequence[str]) -> None:
        """One line of the operator."""
        if not args or args[0] not in VERBS:
            self._say(f"mavcal {'|'.join(VERBS)}")
            return
        acts: tuple[Callable[..., None], ...] = (
            self._use,
            self._start,
            self._answer,
            self._accept,
            self._cancel,
            self._status,
        )
        try:
            acts[VERBS.index(args[0])](*args[1:])
        except TypeError:
            self._say(f"mavcal {args[0]}: another number of words is needed")
        except (ApiProblem, Unreachable) as error:
            self._say(f"mavcal: {error}")

    def idle_task(self) -> None:
        """Say what the follower has heard; MAVProxy's own thread alone writes to the console."""
        while True:
            try:
                text = self._told.get_nowait()
            except queue.Empty:
                return
            self._say(text, aloud=True)

    def _client(self) -> Client:
        return Client(self._url, key=os.environ.get("MAVCAL_API_KEY"))

    def _use(self, url: str) -> None:
        self._url = url

    def _start(self, kind: str) -> None:
        with self._client() as service:
            system = self.target_system
            if not system:
                self._say("MAVProxy has heard no vehicle yet: repeat this once it says 'online system'")
                return
            vehicles = [vehicle for vehicle in service.list_vehicles() if vehicle.system == system]
            if not vehicles:
                self._say(f"mavcal hears no vehicle with system id {system}")
                return
            self._job = service.start_job(vehicles[0].id, kind=kind).id
        threading.Thread(target=self._follow, args=(self._job,), daemon=True).start()

    def _answer(self, value: str) -> None:
        with self._client() as service:
            service.answer_job(self._job, value=value)

    def _accept(self) -> None:
        with self._client() as service:
            plan = service.get_plan(self._job)
            service.apply_plan(self._job, plan_sha256=plan.sha256, reboot=True, idempotency_key=self._job)

    def _cancel(self) -> None:
        with self._client() as service:
            service.cancel_job(self._job)

    def _status(self) -> None:
        with self._client() as service:
            job = service.get_job(self._job)
        self._say(f"{job.kind}: {job.state}. {job.prompt.text if job.prompt else ''}")

    def _follow(self, job: str) -> None:
        """In a thread of its own: hand prompts and states on until the job has ended."""
        try:
            with self._client() as service:
                for message in service.follow_job(job):
                    event = message.data
                    if isinstance(event, PromptEvent) and getattr(event.data, "text", ""):
                        self._told.put(event.data.text)
                    elif isinstance(event, StateEvent):
                        self._told.put(f"calibration: {event.data.state}")
                        if event.data.state in OVER:
                            return
        except (ApiProblem, Unreachable) as error:
            self._told.put(f"mavcal: {error}")

    def _say(self, text: str, *, aloud: bool = False) -> None:
        if aloud:
            self.say(text)  # writes it to the console too
        else:
            self.console.writeln(text)


def init(mpstate: Any) -> MavcalModule:
    """What MAVProxy calls."""
    return MavcalModule(mpstate)
