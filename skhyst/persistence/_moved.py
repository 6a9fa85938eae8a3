"""Classes by the names that files of earlier versions call them, and what they are called now."""

import io
import json
import zipfile

_SCHEMA = "schema.json"  # of a skops file
_NODES = "skhyst.operators._composition"

MOVED = {
    # in JSON: public names
    "skhyst.compose.ColumnOperator": "skhyst.operators.ColumnOperator",
    "skhyst.compose.ModulatedOperator": "skhyst.operators.ModulatedOperator",
    "skhyst.compose.ScheduledOperator": "skhyst.operators.ScheduledOperator",
    # in skops files: where a class is defined
    "skhyst.compose._stages.Stage": "builtins.tuple",  # derived from the rest of a search's tree
    "skhyst.compose._columns.ColumnOperator": f"{_NODES}.ColumnOperator",
    "skhyst.compose._columns.ModulatedOperator": f"{_NODES}.ModulatedOperator",
    "skhyst.compose._scheduled_parameters.ScheduledOperator": f"{_NODES}.ScheduledOperator",
}


def with_present_names(path):
    """Return the bytes of a skops file with the present names of its classes."""
    content = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(content, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == _SCHEMA:
                data = json.dumps(json.loads(data, object_hook=_renamed)).encode()
            new.writestr(name, data)
    return content.getvalue()


def _renamed(node):
    name = MOVED.get(f"{node.get('__module__')}.{node.get('__class__')}")
    if name is not None:
        node["__module__"], _, node["__class__"] = name.rpartition(".")
    return node
