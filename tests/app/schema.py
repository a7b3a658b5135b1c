"""What of a value breaks a JSON schema, for the parts of JSON Schema that ours has."""

from typing import Any

_TYPES: dict[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "number": (int, float),
    "integer": int,
    "boolean": bool,
    "null": type(None),
}
_KNOWN = {
    *("$schema", "$defs", "$ref", "title", "description", "discriminator", "type", "properties", "required"),
    *("additionalProperties", "items", "prefixItems", "minItems", "maxItems", "enum", "const", "anyOf", "oneOf"),
    *("minimum", "maximum", "exclusiveMinimum", "default"),
}


def violations(value: Any, schema: dict[str, Any], root: dict[str, Any] | None = None, place: str = "") -> list[str]:
    """Places that break the schema, and how; a keyword that isn't known breaks it too."""
    root = root or schema
    found = [f"{place}: {keyword}?" for keyword in schema.keys() - _KNOWN]
    if "$ref" in schema:
        return found + violations(value, root["$defs"][schema["$ref"].split("/")[-1]], root, place)
    for several in ("anyOf", "oneOf"):
        if several in schema and not any(not violations(value, one, root, place) for one in schema[several]):
            return [*found, f"{place}: {several}"]
    if "type" in schema:
        right = isinstance(value, _TYPES[schema["type"]])
        if not right or (isinstance(value, bool) and schema["type"] != "boolean"):
            return [*found, f"{place}: expected {schema['type']}"]
    if value != schema.get("const", value) or value not in schema.get("enum", [value]):
        found.append(f"{place}: {value}")
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        found += [f"{place}.{name}: missing" for name in schema.get("required", ()) if name not in value]
        if schema.get("additionalProperties") is False:
            found += [f"{place}.{name}: unknown" for name in value.keys() - properties.keys()]
        for name in value.keys() & properties.keys():
            found += violations(value[name], properties[name], root, f"{place}.{name}")
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            found.append(f"{place}: {len(value)} items")
        first = schema.get("prefixItems", [])
        for i, item in enumerate(value):
            of_item = first[i] if i < len(first) else schema.get("items", {})
            found += violations(item, of_item, root, f"{place}[{i}]")
    if isinstance(value, int | float) and not isinstance(value, bool):
        small = value < schema.get("minimum", value) or value <= schema.get("exclusiveMinimum", value - 1)
        if small or value > schema.get("maximum", value):
            found.append(f"{place}: {value} is out of range")
    return found
