"""`skhyst export`: a model in a file as a C99 program or as a functional mock-up unit."""

from pathlib import Path

from ._files import check_outputs
from ._model_files import load_model
from .export import to_c, to_fmu
from .records import read_records

_FOR_C, _FOR_FMU = ("name", "dtype", "drive", "column"), ("fmi_version",)


def add_export(commands):
    """Return the parser of the command, which is told the model yet."""
    about = "a fitted model, compensator or controller as a C99 program or an FMU"
    parser = commands.add_parser("export", help=about)
    add = parser.add_argument
    to = parser.add_mutually_exclusive_group(required=True)
    to.add_argument("--c", type=Path, metavar="DIR", help="folder for the C files")
    unit = "functional mock-up unit, which is called as the file is"
    to.add_argument("--fmu", type=Path, metavar="FILE.fmu", help=unit)
    add("--dt", type=float, metavar="S", help="sampling interval (default: that of the fit)")
    add("--initial-state", choices=("rest", "zero"), help="(default: that of the model)")
    add("--u0", type=float, default=0.0, help="input at which the device rests (default: 0)")
    units = "name of its unit in an FMU; for int32 what of it the integer 1 stands for"
    add("--input-unit", metavar="UNIT", help=units)
    add("--output-unit", metavar="UNIT", help=units)
    for_c = parser.add_argument_group("for --c")
    add = for_c.add_argument
    add("--name", help="how files and functions are called (default: as the model's file)")
    add("--dtype", choices=("float64", "float32", "int32"), help="(default: float64)")
    add("--drive", type=Path, metavar="FILE", help="input of the test program; int32 needs it")
    column = "column of the drive (default: the second); repeat it for a model of several inputs"
    add("--column", action="append", metavar="COL", help=column)
    for_fmu = parser.add_argument_group("for --fmu")
    for_fmu.add_argument("--fmi-version", choices=("2.0", "3.0"), help="(default: 3.0)")
    parser.set_defaults(run=_export)
    return parser


def _export(options):
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


def _export_c(model, options, more):
    name = options.name or options.model.stem
    _check([options.c / f"{name}{end}" for end in (".h", ".c", "_test.c")], options)
    for unit in ("input_unit", "output_unit"):
        if more[unit] is not None:
            more[unit] = float(more[unit])
    if options.drive:
        first, *others = options.column or [1]
        more["drive"] = read_records(options.drive, drive=first, auxiliary=others)[0].to_numpy()
    return to_c(model, options.c, name, options.dtype or "float64", **more)


def _export_fmu(model, options, more):
    if options.fmu.suffix.lower() != ".fmu":
        raise ValueError(f"The unit must end in .fmu. Got {options.fmu} instead.")
    _check([options.fmu], options)
    path = to_fmu(model, options.fmu, options.fmi_version or "3.0", **more)
    try:
        from fmpy.validation import validate_fmu
    except ImportError:
        print('not validated: FMPy does that. Install with: python -m pip install "skhyst[fmi]"')
    else:
        print(f"validated by FMPy: {'; '.join(validate_fmu(str(path))) or 'no finding'}")
    return [path]


def _check(paths, options):
    inputs = [options.model] + ([options.drive] if options.drive else [])
    check_outputs(paths, inputs, force=options.force)
