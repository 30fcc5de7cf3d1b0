"""Names and alignment as commands use them: the station file's settings, and what the options say."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.alignment.aligner import Aligner
from service.alignment.interpreter import Interpreter
from service.alignment.targets import parse_anchor, parse_target
from service.identity.anchors import check_anchors
from service.identity.namer import TubeNamer

if TYPE_CHECKING:
    import argparse

    from service.config.alignment import GuideSettings, IdentitySettings
    from service.config.generators import SteamGenerator

__all__ = ["interpreter_for"]


def interpreter_for(
    args: argparse.Namespace, identity: IdentitySettings, guide: GuideSettings | None, generator: SteamGenerator
) -> Interpreter | None:
    """What names the tubes and judges the alignment; None where there is neither an anchor nor a guide.

    Raises
    ------
    ConfigError
        An anchor or target that cannot be, or a target without a guide.
    """
    rule = identity.rule(generator)
    anchors = [parse_anchor(text, rule) for text in args.anchor]
    if anchors:
        check_anchors(rule, anchors)
    if args.target is not None and guide is None:
        raise ConfigError(
            "--target: there is no guide to align; give [alignment] guide in the station file, as align-setup writes it"
        )
    if guide is None:
        return Interpreter(TubeNamer(rule, anchors), None) if anchors else None
    settings = guide.settings(generator)
    target = parse_target(settings.target if args.target is None else args.target, rule)
    return Interpreter(TubeNamer(rule, anchors), Aligner(settings, generator.lattice, target))
