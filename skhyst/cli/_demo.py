"""`skhyst demo`: record a simulated actuator with a hidden effect, and search the recording."""

from .._files import replacing
from ..discovery import parse_model
from ..records import read_records
from ._demo_recording import make_demo_recording
from ._diagnose import conclude, make_search, prepare


def demo(options):
    """Write a recording, search it, and print the effect that was hidden in it."""
    recording = options.output / "recording.csv"
    outputs = [options.output / name for name in ("report.html", "model.joblib", "result.json")]
    options.report, options.save, options.json = outputs
    prepare([recording, *outputs], [], options)
    table, secret, description = make_demo_recording(options.seed)
    with replacing(recording) as (part,):
        table.to_csv(part, index=False)
    print(f"A piezo actuator was simulated and recorded in {recording}.")
    print("The model is Prandtl-Ishlinskii; the search sees the recording and nothing else.")
    columns = {"drive": "voltage", "response": "position", "time": "time", "record": "record"}
    X, y = read_records(recording, **columns)
    search = make_search(parse_model("prandtl_ishlinskii"), options).fit(X, y)
    conclude(search, options, None)
    print(f"What had been put in: {secret}, {description}.")
