"""The folder of a loop, with the data of every round, so that an interrupted loop can go on.

``progress.json`` has the identity and the progress of the loop. ``round-N/flown.json`` marks a complete flight;
``round-N/round.json`` has the result of its diagnosis.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mavcal.calib.report import to_json
from mavcal.service.closing.errors import OtherClosing, WorkFolderUnusable
from mavcal.service.closing.logs import Flown
from mavcal.service.closing.mission import MissionKind
from mavcal.service.closing.rounds import Json, RoundResult
from mavcal.service.closing.settings import SimSettings

SCHEMA = "closing/1"
PROGRESS, FLOWN, ROUND, DIAGNOSIS = "progress.json", "flown.json", "round.json", "diagnosis.json"
_UNSAID = {"mission": MissionKind.STANDARD.value}
"""Identity values of a loop that folders of earlier versions lack."""


class WorkFolder:
    """The folder of one loop.

    `identity` must be the same for its rounds to stay valid: flight, command, mission, initial settings.

    Raises
    ------
    OtherClosing
        If the folder belongs to another loop.
    WorkFolderUnusable
        If it cannot be made.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self.path = path
        self._identity = to_json(dict(identity))
        with _written(path):
            path.mkdir(parents=True, exist_ok=True)
        kept = read_json(path / PROGRESS)
        before, now = {**_UNSAID, **(kept or {}).get("of", {})}, {**_UNSAID, **self._identity}
        if kept is not None and before != now:
            other = [name for name, value in now.items() if before.get(name) != value]
            raise OtherClosing(
                f"{path} holds the rounds of another loop ({', '.join(other)} differ): choose another folder by "
                "--work, or remove this one"
            )

    @contextmanager
    def owned(self) -> Iterator[None]:
        """Own the folder while the loop runs, and report what cannot be written.

        Raises
        ------
        OtherClosing
            If another process owns it.
        WorkFolderUnusable
            If something cannot be written there.
        """
        with _written(self.path):
            held = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                yield
            except BlockingIOError as error:
                raise OtherClosing(
                    f"another loop runs in {self.path} now: wait until it has ended, or choose another folder by --work"
                ) from error
            finally:
                os.close(held)

    def round_folder(self, number: int) -> Path:
        """Folder of a round's files."""
        return self.path / f"round-{number}"

    def result(self, number: int, settings: SimSettings) -> RoundResult | None:
        """Result of a round that is done and flew with `settings`; None: there is none."""
        kept = read_json(self.round_folder(number) / ROUND)
        if kept is None or kept.get("settings") != to_json(settings.as_json()):
            return None
        return RoundResult(
            number=kept["round"],
            verdict=kept["verdict"],
            tested=kept["tested"],
            effects=tuple(kept["effects"]),
            closed=kept["closed"],
            rollout=tuple(kept["rollout"]),
            velocity_error=kept["velocity_error"],
            settings=SimSettings(**kept["settings"]),
            to_set=SimSettings(**kept["to_set"]),
            not_set=tuple(kept["not_set"]),
            log=kept["log"],
            not_tested=tuple(kept.get("not_tested", ())),
            notes=tuple(kept.get("notes", ())),
        )

    def flown(self, number: int, settings: SimSettings) -> Flown | None:
        """The flight of a round, if it is whole and had `settings`."""
        folder = self.round_folder(number)
        kept = read_json(folder / FLOWN)
        if kept is None or kept["settings"] != to_json(settings.as_json()):
            return None
        log = folder / str(kept["log"])
        return Flown(log, tuple(kept.get("notes", ()))) if log.is_file() else None

    def begin_round(self, number: int) -> Path:
        """An empty folder for a round: nothing of an earlier flight may be taken for this one's."""
        folder = self.round_folder(number)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def keep_flown(self, number: int, settings: SimSettings, flown: Flown) -> None:
        """Store that the flight of a round is complete."""
        folder = self.round_folder(number)
        log = str(flown.log.relative_to(folder))
        kept = {"log": log, "settings": settings.as_json(), "notes": list(flown.notes)}
        write_json(folder / FLOWN, kept)

    def keep(self, result: RoundResult, diagnosis: Json) -> None:
        """Write the diagnosis of a round and its result."""
        folder = self.round_folder(result.number)
        write_json(folder / DIAGNOSIS, diagnosis)
        write_json(folder / ROUND, result.as_json())

    def keep_progress(self, number: int, doing: str, share: float, left_s: float | None) -> None:
        """Write how far the loop is."""
        standing = {"round": number, "doing": doing, "share": share, "left_s": left_s}
        write_json(self.path / PROGRESS, {"schema": SCHEMA, "of": self._identity, "standing": standing})


def read_json(file: Path) -> Json | None:
    """The object in `file`; None if it is missing or incomplete."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def write_json(file: Path, document: Mapping[str, Any]) -> None:
    """Write an object so that the file is always whole."""
    beside = file.with_name(f".{file.name}")
    beside.write_text(json.dumps(to_json(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(beside, file)


@contextmanager
def _written(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise WorkFolderUnusable(
            f"{error.filename or path} cannot be written: {error.strerror}. Make room, allow it, or choose another "
            "folder by --work"
        ) from error
