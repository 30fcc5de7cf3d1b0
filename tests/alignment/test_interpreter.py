from dataclasses import replace

import numpy as np

from service.alignment.aligner import Aligner, AlignmentSettings
from service.alignment.interpreter import Interpreter
from service.alignment.targets import parse_target
from service.alignment.verdict import Verdict
from service.identity.anchors import Anchor
from service.identity.namer import TubeNamer
from service.vision.measurement import Doubt, Lock
from tests.alignment.scenes import LATTICE
from tests.alignment.test_aligner import FRAME_NS, NOTHING, RULE, view


def interpreter_for(geometry, target="L88R88"):
    namer = TubeNamer(RULE, [Anchor(0, 0, RULE.parse("L83R87"))])
    return Interpreter(namer, Aligner(AlignmentSettings(geometry), LATTICE, parse_target(target, RULE)))


def test_names_and_alignment_belong_together():
    m, geometry = view()
    interpreter = interpreter_for(geometry)
    names, alignment = interpreter.read(m, 1)
    assert len(names) == len(m.tubes)
    i = int(np.flatnonzero((m.tubes.row == 1) & (m.tubes.column == 2))[0])
    assert names[i] == str(alignment.name) == "L88R88"
    assert alignment.verdict is Verdict.ALIGNED


def test_without_a_lock_there_are_no_names_and_with_a_doubtful_index_none_that_could_be_wrong():
    m, geometry = view()
    interpreter = interpreter_for(geometry)
    names, alignment = interpreter.read(NOTHING, 1)
    assert (list(names), alignment.verdict) == ([], Verdict.NO_LOCK)
    names, alignment = interpreter.read(replace(m, lock=Lock.PARTIAL, doubt=(Doubt.INDEX,)), 1)
    assert (list(names), alignment.verdict) == ([], Verdict.CANNOT_JUDGE)
    names, alignment = interpreter.read(m, 1)
    assert alignment.verdict is Verdict.ALIGNED


def test_a_reopened_source_has_no_names_until_it_is_anchored_again():
    m, geometry = view()
    interpreter = interpreter_for(geometry)
    interpreter.read(m, 1)
    names, alignment = interpreter.read(replace(m, time_ns=FRAME_NS), 2)
    assert (list(names), alignment.verdict, alignment.parallelism.frames) == ([], Verdict.CANNOT_JUDGE, 1)
    interpreter.namer.anchor([Anchor(0, 0, RULE.parse("L83R87"))], 2, 0)
    assert interpreter.read(replace(m, time_ns=2 * FRAME_NS), 2)[1].verdict is Verdict.ALIGNED


def test_names_alone_need_no_guide():
    m, _ = view()
    interpreter = Interpreter(TubeNamer(RULE, [Anchor(0, 0, RULE.parse("L83R87"))]), None)
    names, alignment = interpreter.read(m, 1)
    assert "L83R87" in names
    assert alignment is None


def test_the_same_pictures_mean_the_same_whenever_they_are_read():
    said = []
    for _ in range(2):
        _, geometry = view()
        interpreter = interpreter_for(geometry, "nearest")
        said.append(
            [
                interpreter.read(view((0.02 * k, 0.0), time_ns=k * FRAME_NS, seed=k)[0], 1)[1].to_dict()
                for k in range(10)
            ]
        )
    assert said[0] == said[1]
