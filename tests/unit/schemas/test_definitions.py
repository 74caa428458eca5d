"""The definitions that stand in logs, by which others decode."""

import re

import pytest
from rosbags.typesys import get_types_from_msg

from rpod_schemas.rmw.cdr import definition, typestore
from rpod_schemas.topics import STATUS, TOPICS


@pytest.mark.parametrize("type_name", sorted({topic.type for topic in TOPICS}))
def test_a_definition_is_that_of_the_types_that_are_on_the_wire(type_name):
    found = get_types_from_msg(definition(type_name), type_name)
    assert type_name in found
    for name, (constants, fields) in found.items():
        known_constants, known_fields = typestore().fielddefs[name]
        assert fields == known_fields
        assert sorted(constants) == sorted(known_constants)


def test_the_constants_of_a_status_stand_before_the_field_that_they_name_a_value_of():
    lines = definition(STATUS.type).splitlines()
    for field in ("mode", "source"):
        before = lines[: lines.index(f"uint8 {field}")]
        names = [re.match(r"uint8 ([A-Z_]+)=", line) for line in reversed(before)]
        nearest = [name[1] for name in names[: next(i for i, name in enumerate(names) if not name)] if name]
        assert len(nearest) >= 4
        assert all(name.startswith(f"{field.upper()}_") for name in nearest)
