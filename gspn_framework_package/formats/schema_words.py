"""Describes violations of a JSON Schema in words: which element, why, and what is possible
there."""

from __future__ import annotations

import json
from typing import Any, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.model.errors import closest

_TYPES = {
    "object": "an object",
    "array": "a list",
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "null": "null",
}
_LONGEST = 140  # maximum length of a displayed value


class SchemaWords:
    """Finds and describes the most informative error.

    :param definitions: the definitions that ``$ref`` refers to.
    """

    def __init__(self, definitions: Mapping[str, Any]) -> None:
        self._definitions = definitions

    def most_telling(self, errors: Sequence[Any]) -> Any:
        """Return the outermost error; if several forms are possible, the error of the form that
        fits best."""
        best = min(errors, key=_order)
        while best.validator in ("oneOf", "anyOf") and best.context:
            fits = [self._fit(best.instance, form) for form in best.validator_value]
            meant = [number for number, fit in enumerate(fits) if fit == max(fits)]
            if max(fits) <= 0 or len(meant) > 1:
                break
            inside = [error for error in best.context if error.schema_path[0] == meant[0]]
            best = min(inside, key=_order)
        return best

    def _resolved(self, form: Mapping[str, Any]) -> Mapping[str, Any]:
        while "$ref" in form:
            form = self._definitions[form["$ref"].rpartition("/")[2]]
        return form

    def _forms(self, form: Mapping[str, Any]) -> List[Mapping[str, Any]]:
        form = self._resolved(form)
        inner = form.get("oneOf", form.get("anyOf"))
        return [one for part in inner for one in self._forms(part)] if inner else [form]

    def _fit(self, value: Any, form: Mapping[str, Any]) -> float:
        """How well a value fits a form: 0 is not at all."""
        return max(self._fit_one(value, one) for one in self._forms(form))

    @staticmethod
    def _fit_one(value: Any, form: Mapping[str, Any]) -> float:
        kinds = {str: "string", list: "array", dict: "object", type(None): "null", bool: "boolean"}
        if kinds.get(type(value), "number") != form.get("type"):
            return 0
        if not isinstance(value, dict) or "properties" not in form:
            return 0.1
        known = list(form["properties"])
        return sum(1.0 if key in known else 0.5 if closest(key, known) else 0.0 for key in value)

    def message(self, error: Any) -> Tuple[str, Optional[str]]:
        """Return what is wrong, and a hint."""
        rule, value = error.validator, error.instance
        described = error.schema.get("description") if isinstance(error.schema, Mapping) else None
        hint = described.rstrip(".") if described else None
        shown = _shown(value)
        if rule == "additionalProperties" and unknown_key(error):
            known = sorted(error.schema.get("properties", {}))
            return (
                "%r was unexpected" % unknown_key(error)[0],
                _meant(unknown_key(error)[0], known) + "known here: " + ", ".join(known),
            )
        if rule == "type":
            wanted = error.validator_value
            words = [_TYPES[kind] for kind in ([wanted] if isinstance(wanted, str) else wanted)]
            return "%s is not %s" % (shown, " or ".join(words)), hint
        if rule == "enum":
            return "%s is not one of %s" % (
                repr(value) if isinstance(value, str) else shown,
                error.validator_value,
            ), (_meant(value, error.validator_value) + (hint or "")).strip() or None
        if rule in ("oneOf", "anyOf"):
            forms = [self._form(one) for part in error.validator_value for one in self._forms(part)]
            return "%s is not one of the possible values: %s" % (
                shown,
                "; ".join(dict.fromkeys(forms)),
            ), hint
        if rule == "not":
            both = error.validator_value.get("required", [])
            return "only one of %s is possible" % " and ".join(map(repr, both)), hint
        if rule in ("minLength", "minItems", "minProperties") and not value:
            return "it is empty", hint
        if rule == "pattern":
            return "%s is not possible here" % shown, hint or "it has the form %s" % (
                error.validator_value
            )
        return error.message, hint

    def _form(self, form: Mapping[str, Any]) -> str:
        kind = _TYPES.get(form.get("type", ""), "a value")
        keys = form.get("required")
        if keys:
            kind += " with " + " and ".join(map(repr, keys))
        described = form.get("description")
        return "%s (%s)" % (kind, described.rstrip(".")) if described else kind


def unknown_key(error: Any) -> List[str]:
    """Return a list with the first unknown key, if an unknown key is the error."""
    if error.validator != "additionalProperties" or not isinstance(error.instance, Mapping):
        return []
    return [key for key in error.instance if key not in error.schema.get("properties", {})][:1]


def _order(error: Any) -> Tuple[int, bool, bool]:
    # a misspelt key is often also a missing one; the misspelling is more informative
    forms = error.validator in ("anyOf", "oneOf")
    return len(error.path), forms, error.validator != "additionalProperties"


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _LONGEST else text[: _LONGEST // 2] + " ... " + text[-20:]


def _meant(word: Any, known: Sequence[Any]) -> str:
    meant = closest(word, known)
    return "did you mean '%s'? " % meant if meant else ""
