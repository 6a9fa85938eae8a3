"""`skhyst export`: a model in a file as C, Structured Text or a functional mock-up unit."""

from .._files import check_outputs
from ..export import program_sizes, to_c, to_fmu, to_structured_text
from ..persistence import load_model
from ..records import read_records
from ._reading_options import cell_options

_OF_TEXTS = ("name", "dtype", "drive", "column", "form")
_OPTIONS = {"c": (*_OF_TEXTS, "sizes", "simulink"), "st": _OF_TEXTS, "fmu": ("fmi_version",)}


def export(options):
    """Write the program or the FMU."""
    kind = next(kind for kind in _OPTIONS if getattr(options, kind))
    for name in dict.fromkeys(name for names in _OPTIONS.values() for name in names):
        if getattr(options, name) is not None and name not in _OPTIONS[kind]:
            raise ValueError(f"--{name.replace('_', '-')} is not an option of --{kind}.")
    model = load_model(options.model, options.trust)
    passed = ("dt", "initial_state", "u0", "input_unit", "output_unit")
    more = {name: getattr(options, name) for name in passed}
    for path in (_export_fmu if options.fmu else _export_text)(model, options, more):
        print(f"written: {path}")
    if options.sizes:
        sizes = program_sizes(options.c, options.name or options.model.stem)
        sizes.to_csv(table := _sizes_file(options))
        print(f"written: {table}")
        print("bytes, instructions, cycles on controllers whose compiler and emulator are found:")
        print(sizes.to_string())


def _export_text(model, options, more):
    name, folder = options.name or options.model.stem, options.c or options.st
    ends = (".h", ".c", "_test.c") if options.c else (".st", "_test.st")
    if options.simulink:
        ends, more["simulink"] = (*ends, "_sfun.c"), True
    files = [folder / f"{name}{end}" for end in ends]
    _check([*files, *([_sizes_file(options)] if options.sizes else [])], options)
    for unit in ("input_unit", "output_unit"):
        if options.dtype == "int32" and more[unit] is not None:
            more[unit] = float(more[unit])
    if options.drive:
        first, *others = options.column or [1]
        reading = {"drive": first, "auxiliary": others, **cell_options(options)}
        more["drive"] = read_records(options.drive, **reading)[0].to_numpy()
    more["form"] = options.form or "table"
    write = to_c if options.c else to_structured_text
    return write(model, folder, name, options.dtype or "float64", **more)


def _sizes_file(options):
    return options.c / f"{options.name or options.model.stem}_sizes.csv"


def _export_fmu(model, options, more):
    if options.fmu.suffix.lower() != ".fmu":
        raise ValueError(f"The unit must end in .fmu. Got {options.fmu} instead.")
    _check([options.fmu], options)
    path = to_fmu(model, options.fmu, options.fmi_version or "3.0", **more)
    try:
        from fmpy.validation import validate_fmu
    except ImportError:
        print('not validated: needs FMPy. Install with: python -m pip install "skhyst[fmi]"')
    else:
        print(f"validated by FMPy: {'; '.join(validate_fmu(str(path))) or 'no finding'}")
    return [path]


def _check(paths, options):
    inputs = [options.model] + ([options.drive] if options.drive else [])
    check_outputs(paths, inputs, force=options.force)
