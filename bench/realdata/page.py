"""``docs/real-data.md``."""

from __future__ import annotations

from collections.abc import Sequence

from bench.realdata.finding import Finding, table

_TEXT = """# Real recordings with a known answer

`scripts/realdata` fits every recording below and writes this page; it exits 1 if an answer differs. The recordings
were made by others and are not part of this repository: they lie in `../shared/data`, whose README says where each
comes from, how its answer is known and how sure it is. "Known" answers there are certificates, published values, or
least-squares fits made independently of this project: none is an exact truth. Ours stands with its own standard
deviation; it agrees if it lies within what the known answer is good for, plus two standard deviations of ours.

{count} answers, {agree} agree{differ}.

{sections}
"""

_NOTES = {
    "imu_tk_xsens": "51 175 samples of an Xsens MTi at 100 Hz in counts, 37 positions held by hand.",
    "mikoff_mpu9150x5 imu0": "An MPU-9150 in SI units at 100 Hz, 22-23 positions, some knocks.",
    "mikoff_mpu9150x5 imu1": "A second MPU-9150 on the same board.",
    "cuyo_mpu6050": "An MPU-6050 in counts with about ten positions: too few for the cross terms, to be said.",
    "imucal_ferraris": "Six faces and one turn about each axis. `ferraris` is imucal's own method, computed in "
    "`bench/realdata/ferraris.py` from the equations of Ferraris, Grimaldi and Parvis (1995).",
    "mag_cuyo_qmc5883l filtered": "A QMC5883L in counts. The published centres carry the choice of their estimator.",
    "mag_cuyo_qmc5883l noisy": "The same sensor without its filter.",
    "mag_ellipsoid_fit_python": "347 points in counts.",
    "ntars": "A device warming and cooling, 49 rows of counts, half of them twice.",
    "temp_cats_imu": "A motionless device over slow sweeps of temperature in two orientations. A slope fitted on one "
    "sweep is judged on the other; about the residual's mean, which the orientation changes.",
    "allan_galaxy_s5": "A phone at rest for six hours, 10 Hz, low-pass filtered.",
}


def page(findings: Sequence[Finding]) -> str:
    """The whole page."""
    judged = [f for f in findings if f.agrees is not None]
    differ = [f for f in judged if not f.agrees]
    names = list(dict.fromkeys(f.recording for f in findings))
    sections = "\n\n".join(
        f"## {name}\n\n{_NOTES[name]}\n\n{table([f for f in findings if f.recording == name])}" for name in names
    )
    words = f", {len(differ)} differ" if differ else ""
    return _TEXT.format(count=len(judged), agree=len(judged) - len(differ), differ=words, sections=sections)
