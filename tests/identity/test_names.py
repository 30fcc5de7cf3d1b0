import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.config.generators import Naming, load_generator
from service.identity.counting import NamingRule
from service.identity.names import Leg, NamingError, TubeName, parse_name

CE, WESTINGHOUSE = Naming.LINE_ROW, Naming.ROW_COLUMN
numbers = st.integers(1, 999)
spaces = st.sampled_from(["", " ", "  "])


@pytest.mark.parametrize(
    "text",
    [
        *("L83R87", "l83r87", "L83 R87", " L083R087 ", "r87 l83", "83/87", "83-87", "83 87", "L83/R87"),
        *("L83-R87", "Line 83 Row 87", "LINE:83, ROW:87", "ln83 r87", "row=87 line=83", "HL L83R87", "L83R87 HL"),
        *("SG2 HL 83/87", "sg-2 hl l83r87", "SG 2: L83R87"),
    ],
)
def test_every_spelling_of_a_line_and_row_is_read(text):
    assert parse_name(text, CE, "SG2", Leg.HOT) == TubeName(CE, row=87, column=83)


@pytest.mark.parametrize(
    "text",
    ["ROW12 COL34", "R12C34", "r12 c34", "ROW 12 COLUMN 34", "row12col34", "C34R12", "12-34", "12/34", "R12, C34"],
)
def test_every_spelling_of_a_row_and_column_is_read(text):
    assert parse_name(text, WESTINGHOUSE) == TubeName(WESTINGHOUSE, row=12, column=34)


@pytest.mark.parametrize(
    "text",
    [
        *("", "L83", "83", "8387", "L83L87", "R83R87", "83/87/1", "-5/3", "L-83R87", "L83R87?", "83.87", "83,87"),
        *("L83R", "83L87R", "L8 3R87", "C83R87", "L83C87", "L٣R5", "LINE", "L83R87 L83R87"),
    ],
)
def test_what_has_no_single_meaning_is_refused_with_an_example(text):
    with pytest.raises(NamingError, match=r"cannot be read; .* named like L83R87"):
        parse_name(text, CE)


def test_lines_are_not_columns():
    with pytest.raises(NamingError, match="named like ROW12 COL34"):
        parse_name("L83R87", WESTINGHOUSE)


@pytest.mark.parametrize("text", ["L0R2", "L1000R2"])
def test_impossible_numbers_are_refused(text):
    with pytest.raises(NamingError, match="from 1 to 999"):
        parse_name(text, CE)


def test_a_tube_of_the_other_leg_or_steam_generator_is_not_taken_for_one_of_this():
    with pytest.raises(NamingError, match="is in leg CL; this one is HL"):
        parse_name("CL L83R87", CE, "SG2", Leg.HOT)
    with pytest.raises(NamingError, match="is in SG1; this one is SG2"):
        parse_name("SG1 L83R87", CE, "SG2", Leg.HOT)
    with pytest.raises(NamingError, match=r"is in leg CL; set \[identity\] leg"):
        parse_name("L83R87CL", CE)
    with pytest.raises(NamingError, match=r"set \[identity\] steam_generator"):
        parse_name("SG1 L83R87", CE)
    with pytest.raises(NamingError, match="is in SG21; this one is SG2"):
        parse_name("SG21 L83R87", CE, "SG2")


@given(naming=st.sampled_from(Naming), row=numbers, column=numbers, leg=st.sampled_from([None, *Leg]))
def test_what_is_printed_is_read_back(naming, row, column, leg):
    name = TubeName(naming, row, column)
    assert parse_name(str(name), naming) == name
    for sg in ("", "SG2", "SG-A", "Kori 2 SG1"):
        assert parse_name(name.full(sg, leg), naming, sg, leg) == name
        assert parse_name(name.full(sg, leg).lower(), naming, sg, leg) == name


@given(row=numbers, column=numbers, a=spaces, b=spaces, c=spaces)
def test_spaces_and_case_change_nothing(row, column, a, b, c):
    name = TubeName(CE, row, column)
    assert parse_name(f"l{a}{column}{b}r{c}{row}", CE) == name
    assert parse_name(f"R{a}{row}{b}L{c}{column}", CE) == name


@given(row=numbers, column=numbers)
def test_on_a_system_80_row_and_line_have_an_even_sum(row, column):
    rule = NamingRule(CE, load_generator("system80").lattice)
    if (row + column) % 2 == 0:
        assert rule.parse(f"L{column}R{row}") == TubeName(CE, row, column)
    else:
        with pytest.raises(NamingError, match=rf"{row} \+ {column} is odd"):
            rule.parse(f"L{column}R{row}")


def test_the_full_name_says_where():
    assert TubeName(CE, 87, 83).full("SG2", Leg.COLD) == "SG2 CL L83R87"
    assert TubeName(WESTINGHOUSE, 12, 34).full() == "ROW12 COL34"
