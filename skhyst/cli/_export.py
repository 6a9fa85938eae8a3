"""`skhyst export`: a model in a file as a C99 program or as a functional mock-up unit."""

from .._files import check_outputs
from ..export import program_sizes, to_c, to_fmu
from ..persistence import load_model
from ..records import read_records

_FOR_C = "name", "dtype", "drive", "column", "form", "sizes"
_FOR_FMU = ("fmi_version",)


def export(options):
    """Write the C program or the FMU."""
    for name in _FOR_FMU if options.c else _FOR_C:
        if getattr(options, name) is not None:
            raise ValueError(
                f"--{name.replace('_', '-')} is not an option of --{'c' if options.c else 'fmu'}."
            )
    model = load_model(options.model, options.trust)
    passed = ("dt", "initial_state", "u0", "input_unit", "output_unit")
    more = {name: getattr(options, name) for name in passed}
    for path in (_export_c if options.c else _export_fmu)(model, options, more):
        print(f"written: {path}")
    if options.sizes:
        sizes = program_sizes(options.c, options.name or options.model.stem)
        sizes.to_csv(table := _sizes_file(options))
        print(f"written: {table}")
        print("bytes and instructions on controllers, as far as compilers and emulators are found:")
        print(sizes.to_string())


def _export_c(model, options, more):
    name = options.name or options.model.stem
    files = [options.c / f"{name}{end}" for end in (".h", ".c", "_test.c")]
    _check([*files, *([_sizes_file(options)] if options.sizes else [])], options)
    for unit in ("input_unit", "output_unit"):
        if options.dtype == "int32" and more[unit] is not None:
            more[unit] = float(more[unit])
    if options.drive:
        first, *others = options.column or [1]
        more["drive"] = read_records(options.drive, drive=first, auxiliary=others)[0].to_numpy()
    more["form"] = options.form or "table"
    return to_c(model, options.c, name, options.dtype or "float64", **more)


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
