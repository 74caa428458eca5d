"""A YAML loader that refuses what PyYAML passes over, or answers with an error without a line.

PyYAML keeps only the last of two fields of one name, without an error, so that a bus or a list of sensors
that a file gives twice would be lost. A number or a date that Python cannot represent ends in a
``ValueError``.
"""

from typing import Any

import yaml
from yaml.composer import ComposerError
from yaml.constructor import ConstructorError

_MERGE = "tag:yaml.org,2002:merge"


def read_yaml(text: str) -> Any:
    """Return the document of a YAML or JSON text. Raises ``yaml.YAMLError``."""
    loader = _StrictLoader(text)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


class _StrictLoader(yaml.SafeLoader):
    """The safe loader; a field that is given twice and an impossible value are errors with a line."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Return a mapping before others are merged into it. Raises ``ComposerError`` if a field is twice."""
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        lines: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == _MERGE:
                continue
            if (key.tag, key.value) in lines:
                problem = f"{key.value!r} is given a second time, after line {lines[key.tag, key.value]}"
                raise ComposerError(None, None, f"{problem}; leave one of the two", key.start_mark)
            lines[key.tag, key.value] = key.start_mark.line + 1
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Return the value of a node. Raises ``ConstructorError``: Python cannot represent it."""
        try:
            return super().construct_object(node, deep=deep)
        except (ValueError, LookupError, AttributeError) as error:
            problem = f"is no value that can be read ({error}); quote it if it is a text"
            raise ConstructorError(None, None, problem, node.start_mark) from error
