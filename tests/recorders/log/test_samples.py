"""The episodes in samples/ are what samples/README.md says, and true."""

from pathlib import Path

import pytest

from mapreplay.analysis.diagnosis.diagnosis import diagnose
from mapreplay.analysis.diagnosis.record import diagnosis_path, record_of, to_json
from mapreplay.analysis.verification import verify
from mapreplay.recorders.log.find import find_logs
from mapreplay.recorders.log.reader import EpisodeLog

SAMPLES = Path(__file__).parents[3] / "samples"
ENDS = {
    "procedural-60002__nearest__observed-observed__s1.mcap": ("mapped", 520),
    "procedural-60002__cost-utility__fused-fused__s1.mcap": ("mapped", 104),
    "procedural-60014__cost-utility__fused-fused__s1.mcap": ("sealed_in", 10),
}
SEALED = {
    "procedural-50005__cost-utility__fused-fused__s1.mcap": ("mapped", 183),
    "procedural-50009__cost-utility__fused-fused__s1.mcap": ("sealed_in", 102),
    "procedural-50053__cost-utility__fused-fused__s1.mcap": ("sealed_in", 7),
}


def test_every_sample_is_listed_and_small() -> None:
    logs = find_logs([SAMPLES / "episodes"])
    assert {log.name for log in logs} == set(ENDS)
    assert all(log.stat().st_size < 1_000_000 for log in logs)
    listed = (SAMPLES / "README.md").read_text(encoding="utf-8")
    for path in SAMPLES.rglob("*.*"):
        if path.name != "README.md" and "__pycache__" not in path.parts:
            assert path.name in listed or path.suffix == ".pgm", path


@pytest.mark.parametrize("name", ENDS)
def test_a_sample_is_what_it_is_said_to_be(name: str) -> None:
    log = EpisodeLog(SAMPLES / "episodes" / name)
    assert log.summary is not None
    assert (log.outcome, log.summary.steps) == ENDS[name]
    assert verify(log).agrees


@pytest.mark.parametrize("name", SEALED)
def test_a_sealed_sample_has_its_diagnosis_beside_it(name: str) -> None:
    path = SAMPLES / "sealed" / name
    log = EpisodeLog(path)
    assert log.summary is not None
    assert (log.outcome, log.summary.steps) == SEALED[name]
    assert path.stat().st_size < 1_000_000
    assert verify(log).agrees
    beside = diagnosis_path(path).read_bytes()
    assert to_json(record_of(diagnose(log))) == beside
