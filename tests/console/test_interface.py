"""The HTTP interface against its own description, by requests that nobody thought of."""

import warnings

import pytest
from hypothesis import HealthCheck, Phase, settings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import schemathesis
    from schemathesis.specs.openapi.checks import unsupported_method

from tests.console.conftest import HERE
from tests.fakes.drawn import made_up
from tests.fakes.station import TOKENS, FakeStation

OURS = {"origin": HERE, "host": "127.0.0.1:8420"}


def open_station():
    station = FakeStation()
    station.web._requests.take = station.web._logins.take = lambda client: True  # how many is tested by itself
    station.show(*made_up(0))
    return station


def network_station():
    station = FakeStation(tokens=TOKENS, address="0.0.0.0")
    station.web._requests.take = station.web._logins.take = lambda client: True
    return station


OPEN = schemathesis.openapi.from_asgi("/api/schema.json", open_station().app, headers={"host": "127.0.0.1:8420"})
NETWORK = schemathesis.openapi.from_asgi("/api/schema.json", network_station().app, headers={"host": "127.0.0.1:8420"})
FEW = settings(
    max_examples=25,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
    derandomize=True,
)


@pytest.fixture(autouse=True)
def commands_in_the_loop(monkeypatch):
    """The client's loops come and go with every request, and would leave the commands' thread behind."""

    async def at_once(run, *arguments):
        return run(*arguments)

    monkeypatch.setattr("service.console.app.to_thread.run_sync", at_once)


@pytest.mark.filterwarnings("ignore")
@OPEN.parametrize()
@FEW
def test_every_request_is_answered_as_described(case):
    case.call_and_validate(headers=OURS, excluded_checks=[unsupported_method])


@pytest.mark.filterwarnings("ignore")
@NETWORK.parametrize()
@FEW
def test_without_a_token_no_request_gets_anything(case):
    response = case.call(headers=OURS)
    assert 400 <= response.status_code < 500
    assert set(response.json()) == {"error"}
