"""JSON schemas, as the description of the page's interface has them.

In the mappings of fields here, a name with a question mark is a field that may be missing.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping

Schema = Dict[str, Any]

TEXT: Schema = {"type": "string"}
WHOLE: Schema = {"type": "integer", "minimum": 0}
FLAG: Schema = {"type": "boolean"}
OBJECT: Schema = {"type": "object"}
NAMES: Schema = {"type": "array", "items": TEXT}
NUMBER: Schema = {"type": "number"}
COUNTS: Schema = {"type": "array", "items": WHOLE}
POINT: Schema = {"type": "array", "items": NUMBER}
OBJECTS: Schema = {"type": "array", "items": OBJECT}


def described_as(schema: Schema, text: str) -> Schema:
    """The schema with a description for people."""
    return {**schema, "description": text}


def or_null(schema: Schema) -> Schema:
    """A value of the schema, or null."""
    return {**schema, "type": [schema["type"], "null"]}


def map_to(schema: Schema) -> Schema:
    """An object with any names, and values of this schema."""
    return {"type": "object", "additionalProperties": schema}


def object_with(fields: Mapping[str, Schema]) -> Schema:
    """An object with these fields, and perhaps others."""
    return {
        "type": "object",
        "properties": {name.rstrip("?"): schema for name, schema in fields.items()},
        "required": [name for name in fields if not name.endswith("?")],
    }


def list_with(fields: Mapping[str, Schema]) -> Schema:
    """A list of objects with these fields."""
    return {"type": "array", "items": object_with(fields)}


def component(name: str) -> Schema:
    """A reference to a schema of the document by its name."""
    return {"$ref": "#/components/schemas/" + name}
