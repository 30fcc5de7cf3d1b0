"""The HTTP interface in OpenAPI's words, for programs that operate the station, and for tests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from service import __version__
from service.console.commands import COMMANDS, LOGIN, Argument, Command

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["openapi"]

MEANINGS = {
    "400": "the request is not what it should be",
    "401": "a token is asked for",
    "403": "not from this page, or the token is for watching only",
    "409": "cannot be done now",
    "413": "the body is too long",
    "415": "the body must be application/json",
    "429": "too many requests",
}


def openapi() -> dict[str, Any]:
    """The whole interface but for the WebSocket."""
    paths: dict[str, Any] = {
        "/api/state": {"get": {"summary": "how the station does", "responses": _responses(200, "401", "403", "429")}},
        "/api/login": {
            "post": {
                "summary": "exchange a token for a cookie",
                "requestBody": _body(LOGIN),
                "responses": _responses(200, "400", "401", "403", "413", "415", "429"),
            }
        },
    }
    for name, command in COMMANDS.items():
        paths[f"/api/{name}"] = {"post": _operation(command)}
    return {
        "openapi": "3.1.0",
        "info": {"title": "Bowlsight, the operator's station", "version": __version__},
        "components": {"schemas": {"Error": _ERROR}},
        "paths": paths,
    }


_ERROR = {
    "type": "object",
    "properties": {"error": {"type": "string"}},
    "required": ["error"],
    "additionalProperties": False,
}


def _operation(command: Command) -> dict[str, Any]:
    return {
        "summary": command.summary,
        "requestBody": _body(command.arguments),
        "responses": _responses(200, *MEANINGS),
    }


def _body(arguments: Mapping[str, Argument]) -> dict[str, Any]:
    schema = {
        "type": "object",
        "properties": {name: argument.schema() for name, argument in arguments.items()},
        "required": [name for name, argument in arguments.items() if argument.required],
        "additionalProperties": False,
    }
    return {"required": True, "content": {"application/json": {"schema": schema}}}


def _responses(done: int, *others: str) -> dict[str, Any]:
    error = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    answer = {"application/json": {"schema": {"type": "object"}}}
    return {
        str(done): {"description": "done", "content": answer},
        **{status: {"description": MEANINGS[status], "content": error} for status in others},
    }
