"""Progress of a simulation: metres and time left, in the log or from a worker process."""

import logging

from mlsroad_pipeline.surveys import simulated


def test_simulated_distance_is_reported_in_the_log_and_from_a_worker(monkeypatch, caplog, capsys):
    times = iter([0.0, 1.0, 20.0, 21.0, 40.0, 60.0])
    monkeypatch.setattr(simulated.time, "monotonic", lambda: next(times))
    caplog.set_level(logging.INFO, "mlsroad_pipeline")
    report = simulated.distance_lines("avenue", 100.0)
    for distance in (5.0, 25.0, 26.0, 50.0, 100.0):
        report(distance)
    assert [r.getMessage() for r in caplog.records] == [
        "avenue: 25 of 100 m, about 60 s left",
        "avenue: 50 of 100 m, about 40 s left",
    ]
    times = iter([0.0, 20.0])
    caplog.set_level(logging.WARNING, "mlsroad_pipeline")
    simulated.distance_lines("avenue", 100.0)(50.0)
    assert capsys.readouterr().err == "avenue: 50 of 100 m, about 20 s left\n"
