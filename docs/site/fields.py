"""The reference's arguments of classes whose `__init__` Equinox writes from their fields: an extension of Griffe."""

import griffe


class Fields(griffe.Extension):
    """Gives every class without an `__init__` one of its own annotated fields."""

    def on_package(self, *, pkg: griffe.Module, **_) -> None:
        _complete(pkg)


def _complete(place: griffe.Object) -> None:
    for member in list(place.members.values()):
        if member.is_alias or not (member.is_module or member.is_class):
            continue
        _complete(member)
        if member.is_class and "__init__" not in member.members:
            parameters = [_parameter(field) for field in member.members.values() if _is_field(field)]
            if parameters:
                init = griffe.Function("__init__", parameters=griffe.Parameters(*parameters), parent=member)
                member.set_member("__init__", init)


def _is_field(member) -> bool:
    """Annotated, and not of the class: Griffe takes the ClassVar off the annotation and leaves a label."""
    if not member.is_attribute or member.annotation is None or "property" in member.labels:
        return False
    return "instance-attribute" in member.labels or "class-attribute" not in member.labels


def _parameter(field) -> griffe.Parameter:
    default = field.value
    if isinstance(default, griffe.ExprCall) and default.canonical_path.rpartition(".")[2] == "field":
        named = {argument.name: argument.value for argument in default.arguments}
        default = named.get("default")
    kind = griffe.ParameterKind.positional_or_keyword
    return griffe.Parameter(field.name, annotation=field.annotation, kind=kind, default=default)
