import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header

from neuse_encoder_node.health import Health


def values(report: DiagnosticArray) -> dict[str, str]:
    return {item.key: item.value for item in report.status[0].values}


def test_report_counts_frames_refusals_and_times():
    health = Health()
    for _ in range(3):
        health.tally("frames")
    health.refuse("empty_mask", 2)
    health.add_time("encode", 0.5, runs=10)
    found = values(health.report("node", Header()))
    assert (found["frames"], found["empty_mask"], found["stage_ms/encode"]) == ("3", "2", "50.000")
    assert float(found["fps"]) > 0


def test_new_refusals_warn_once():
    health = Health()
    health.refuse("empty_mask")
    first, second = health.report("node", Header()), health.report("node", Header())
    assert first.status[0].level == DiagnosticStatus.WARN
    assert "empty_mask" in first.status[0].message
    assert second.status[0].level == DiagnosticStatus.OK
    assert values(second)["empty_mask"] == "1"


def test_fault_is_an_error_until_it_is_taken_back():
    health = Health()
    health.fail("cannot configure: no weights")
    status = health.report("node", Header()).status[0]
    assert (status.level, status.message) == (DiagnosticStatus.ERROR, "cannot configure: no weights")
    health.fail("")
    assert health.report("node", Header()).status[0].level == DiagnosticStatus.OK


def test_time_of_a_block_counts_even_if_it_fails():
    health = Health()
    with pytest.raises(KeyError), health.timed("step"):
        raise KeyError
    assert "stage_ms/step" in values(health.report("node", Header()))


def test_summary_tells_counts_drops_and_refusals_in_one_line():
    health = Health()
    assert health.summary() == "0 frames, 0 objects, 0 edges, 0 dropped, 0 refused"
    health.tally("frames", 120)
    health.state("objects", 7)
    health.state("objects", 6)
    health.tally("external_edges", 3)
    health.refuse("dropped_frame", 2)
    health.refuse("empty_mask", 5)
    said = health.summary()
    assert said == "120 frames, 6 objects, 0 edges, 3 external edges, 2 dropped, 5 refused"
