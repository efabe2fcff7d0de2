"""``python -m bench.film [film|rooms]``: the panel as pictures, for ``docs/panel.md``.

`film` records an accelerometer and a compass calibration of a simulated vehicle at phone size, from the tile to the
proof, as contact sheets. `rooms` takes every room at phone and desk size. Both are made from one run.
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

from bench.film import rooms
from bench.film.sheet import chosen, contact_sheet, save, thinned
from bench.film.shots import DESK, PHONE, Camera, camera
from bench.running import service
from mavcal.client import Client

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "pictures"
SHEET_BYTES, ROOM_BYTES = 600_000, 150_000
FRAMES, COLUMNS, WIDTH = 12, 6, 250
MOST_ALIKE = 2
SPEED = 3.0
"""How much faster than the clock the vehicle lives; the times below the frames are those of the clock."""
READY = {
    "home": ".tile button",
    "job": ".faces li",
    "logs": "#method",
    "gap": "iframe.report",
    "history": "main table, .rows .row",
    "live": ".charts canvas",
}
"""Text that a room shows once it is complete."""


def main() -> int:
    asked = sys.argv[1:] or ["film", "rooms"]
    if not {"film", "rooms"} >= set(asked):
        print(__doc__, file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="mavcal-film-") as folder:
        first = rooms.endpoint(1, speed=SPEED)
        with service(first, Path(folder) / "data") as running, camera(running.url) as looking:
            vehicle = running.found()
            running.client.change_unit(vehicle, name="Heron")
            rooms.written(running.client, vehicle, "gyro")
            if "film" in asked:
                film(looking)
            if "rooms" in asked:
                take_rooms(looking, running.client, vehicle, running.tlogs()[0])
    return 0


def film(looking: Camera) -> None:
    """Both calibrations; the reviews are taken on the way."""
    for sensor, name in (("Accelerometer", "accel"), ("Compass", "compass")):

        def review(place: str, name: str = name) -> None:
            if name == "compass":
                taken(looking, "review", place, ".before-after img")

        frames = looking.calibration(sensor, review)
        sheet = contact_sheet(chosen(thinned(frames, MOST_ALIKE), FRAMES), COLUMNS, WIDTH)
        save(sheet, PICTURES / f"panel-film-{name}.png", SHEET_BYTES)
        print(f"{name}: {len(frames)} changes in {frames[-1].at:.0f} s")


def take_rooms(looking: Camera, client: Client, vehicle: str, flight: Path) -> None:
    """Every room with something in it; `flight` is a telemetry log of the vehicle."""
    waits = rooms.connected(client, rooms.endpoint(2, speed=1, hand="off", seed=4))
    client.change_unit(waits, name="Kestrel")
    gap = client.diagnose_gap(real=client.upload_recording(rooms.flown(), name="flight.csv").id).id
    log = client.upload_recording(flight.read_bytes(), name="bench.tlog").id
    for _ in range(4):
        client.run_preflight(vehicle)
    rooms.until(lambda: client.get_gap(gap).state == "succeeded", "the diagnosis")
    places = {
        "home": "",
        "logs": f"#/log/{log}",
        "gap": f"#/gap/{gap}",
        "history": f"#/history/{vehicle}",
        "live": f"#/vehicle/{vehicle}/live",
        "job": f"#/job/{rooms.capturing(client, waits)}",
    }
    for room, place in places.items():
        taken(looking, room, place, READY[room])


def taken(looking: Camera, room: str, place: str, ready: str) -> None:
    """A room at both sizes, in files named after it."""
    for size, end in ((DESK, ""), (PHONE, "-phone")):
        shot = Image.open(io.BytesIO(looking.room(place, ready, size, there=room == "live")))
        save(shot, PICTURES / f"panel-{room}{end}.png", ROOM_BYTES)


if __name__ == "__main__":
    sys.exit(main())
