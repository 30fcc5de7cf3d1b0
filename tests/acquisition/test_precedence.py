import os
import threading

import pytest

from service.acquisition.live import LiveService
from service.precedence import FIRST, come_along, go_between, go_first
from tests.fakes.scripted import PATIENCE_S, FakeMeasurer, ScriptedGrabber


@pytest.mark.parametrize("allowed", [True, False])
def test_a_thread_asks_to_go_first_and_goes_on_where_it_may_not(monkeypatch, allowed):
    asked = []

    def setpriority(which, who, nice):
        asked.append((which, who, nice))
        if not allowed:
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "setpriority", setpriority)
    go_first()
    assert asked == [(os.PRIO_PROCESS, threading.get_native_id(), FIRST)]


def test_who_may_not_come_along_goes_on_between(monkeypatch):
    def refused(who, policy, _):
        raise PermissionError(1, "Operation not permitted")

    policies = []

    def between():
        go_between()
        with monkeypatch.context() as m:
            m.setattr(os, "sched_setscheduler", refused)
            come_along()
        policies.append(os.sched_getscheduler(threading.get_native_id()))

    thread = threading.Thread(target=between)
    thread.start()
    thread.join(PATIENCE_S)
    assert policies == [os.SCHED_IDLE]


def test_the_two_threads_that_frames_wait_for_ask(monkeypatch):
    asked = []
    for module in ("thread", "worker"):
        name = f"service.acquisition.{module}.go_first"
        monkeypatch.setattr(name, lambda: asked.append(threading.current_thread().name))
    with LiveService(ScriptedGrabber([0]), lambda _: FakeMeasurer()) as service:
        service.start()
        assert service.wait(PATIENCE_S)
    assert sorted(asked) == ["bowlsight-acquisition", "bowlsight-measuring"]
