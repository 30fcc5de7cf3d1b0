import warnings

import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it would rather have httpx2, which schemathesis does not use
    from starlette.testclient import TestClient

from tests.fakes.station import FakeStation

HERE = "http://127.0.0.1:8420"


@pytest.fixture
def serve():
    """Serve a fake station to a client that asks as its own page would; more headers, or others, at will."""
    clients = []

    def start(station=None, **headers):
        station = station or FakeStation()
        given = {"origin": HERE, "host": "127.0.0.1:8420", **{k.replace("_", "-"): v for k, v in headers.items()}}
        client = TestClient(station.app, base_url=HERE, headers={k: v for k, v in given.items() if v is not None})
        clients.append(client.__enter__())
        client.station = station
        return client

    yield start
    for client in clients:
        client.__exit__(None, None, None)
