"""Write a model as a functional mock-up unit: co-simulation around its C99 program."""

import platform
import shutil
import subprocess
import tempfile
from pathlib import Path
from string import Template
from xml.sax.saxutils import quoteattr
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from .._files import errors_naming, replacing
from ._c import DIALECTS, program

_VERSIONS = ("2.0", "3.0")
_XML = Template("""\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="$version" modelName="$name" $token="$digest"
    description="$what" generationTool="skhyst">
  <CoSimulation modelIdentifier="$name" canHandleVariableCommunicationStepSize="false"
      $can$sources
  <UnitDefinitions>
    <Unit name="s"><BaseUnit s="1"/></Unit>$units
  </UnitDefinitions>
  <LogCategories>
    <Category name="logStatusError"/>
  </LogCategories>
  <DefaultExperiment startTime="0" stepSize="$dt"/>
  <ModelVariables>
$variables  </ModelVariables>
  <ModelStructure>
    $structure
  </ModelStructure>
</fmiModelDescription>
""")
_ENDINGS = {"Linux": ".so", "Darwin": ".dylib", "Windows": ".dll"}  # system -> ending of a library
_BUILD = Template("""\
<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="$name">
    <SourceFileSet language="C99">
      <SourceFile name="$name.c"/>
      <SourceFile name="${name}_fmu.c"/>
    </SourceFileSet>
    <Library name="m" external="true"/>
  </BuildConfiguration>
</fmiBuildDescription>
""")


def to_fmu(
    model,
    path,
    version="3.0",
    *,
    dt=None,
    initial_state=None,
    u0=0.0,
    input_unit=None,
    output_unit=None,
    tunable=(),
) -> Path:
    """Write a model, compensator or operator as a functional mock-up unit (FMU) for co-simulation.

    The FMU contains the C99 program of :func:`to_c` in double precision and, if a C compiler is
    found, a library for the present platform, and one for Windows if MinGW's cross-compiler
    ``x86_64-w64-mingw32-gcc`` is. Its state can be read, set and serialized.

    Parameters
    ----------
    model : object with ``stepper``, Stepper, Operator or CompiledStep
        As for :func:`to_c`.
    path : str or Path
        File to write, ``name.fmu``; its folder is created if it is missing. The name without the
        suffix is that of the model: letters, digits and underscores.
    version : {"3.0", "2.0"}, default="3.0"
        Version of the Functional Mock-up Interface (FMI).
    dt : float, optional
        Sampling interval in s; that of the records of the fit by default. Needed for an operator.
    initial_state : {"rest", "zero"}, default=None
        State before the first sample; by default that of ``predict``, of an operator that of rest.
    u0 : float or array-like of shape (n_inputs,), default=0.0
        Input at which the device rests, in units of the drive; the start value of the FMU's input.
    input_unit, output_unit : str, optional
        Names of the units of drive (the same for all inputs) and response, such as ``"V"``.
    tunable : sequence of str, or dict of str to (float, float), default=()
        As for :func:`to_c`: they are the parameters of the FMU, which may change at any time.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    NotImplementedError, TypeError, ValueError
        As :func:`to_c`.

    See Also
    --------
    to_c : The program alone.

    Notes
    -----
    Variables are ``time``, ``input`` (``input_1``, ``input_2``, ... if there are several) and
    ``output``. A communication step is one sampling interval: the input set before it is one
    sample, the output after it is the response to that sample, so in simulation time it appears one
    interval later. Before the first step the device has rested at the start value of its input, if
    the program has ``name_init_at`` (see :func:`to_c`), else at ``u0``. In a step of several
    intervals the input is held; steps of other sizes, and input that is not finite, are refused
    with an error.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skhyst.export import to_fmu
    >>> from skhyst.hysteresis import BacklashOperator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = to_fmu(
    ...         BacklashOperator(0.2), Path(folder, "gear.fmu"), dt=1e-3, input_unit="deg"
    ...     )
    ...     path.name
    'gear.fmu'
    """
    if version not in _VERSIONS:
        raise ValueError(
            f"The 'version' parameter of to_fmu must be one of {_VERSIONS}. Got {version!r} "
            "instead."
        )
    path = Path(path)
    name = path.stem
    units = input_unit, output_unit
    source = program(model, name, "float64", dt, initial_state, u0, None, units, tunable)
    if source.dt is None:
        raise ValueError("The 'dt' parameter of to_fmu must be given, in s.")
    first = (np.zeros(source.n_inputs) + u0).tolist()
    u = "u" if source.by_row else "u[0]"
    init_at = f"{name}_init_at(&it->now.model, {u});" if source.begins_at else ""
    values = [*first, *(entry.value for entry in source.entries)]
    template = Template(Path(__file__).with_name("fmu.c").read_text())
    wrapper = template.substitute(
        name=name,
        version=version,
        major=version[0],
        first=", ".join(map(repr, values)),
        u=u,
        n_parameters=len(source.entries),
        configure=_configure(name, source.entries),
        init_at=init_at or ";",
    )
    with tempfile.TemporaryDirectory() as folder:
        texts = source.files | {f"{name}_fmu.c": wrapper}
        del texts[f"{name}_test.c"]
        with errors_naming(path):
            for file, text in texts.items():
                Path(folder, file).write_text(text, encoding="utf-8")
        files = {f"sources/{file}": text.encode() for file, text in texts.items()}
        files["modelDescription.xml"] = _description(
            name, version, type(model).__name__, source, first, units
        ).encode()
        if version == "3.0":
            files["sources/buildDescription.xml"] = _BUILD.substitute(name=name).encode()
        files |= _binaries(name, version, folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as (part,), ZipFile(part, "w") as archive:
        for file, content in files.items():  # without the date: equal models give equal files
            archive.writestr(ZipInfo(file), content, ZIP_DEFLATED)
    return path


def _configure(name, entries):
    """Return the body of the function in C that applies the parameters."""
    if not entries:
        return "    (void)it;\n    return OK;\n"
    lines = [f"    {name}_params to;\n"]
    for k, entry in enumerate(entries):
        place = entry.field if entry.index is None else f"{entry.field}[{entry.index}]"
        lines.append(f"    to.{place} = it->now.values[PARAMETERS + {k}];\n")
    lines.append(f"    return {name}_configure(&it->now.model, &to)\n")
    lines.append('               ? refused(it, "a parameter is out of its range") : OK;\n')
    return "".join(lines)


def _description(name, version, class_name, source, first, units):
    """Return ``modelDescription.xml``."""
    names = ["input"] if len(first) == 1 else [f"input_{k + 1}" for k in range(len(first))]
    unit = ["" if text is None else f" unit={quoteattr(text)}" for text in units]
    rows = [
        ("time", 'causality="independent"', ' unit="s"', ""),
        ("output", 'causality="output" initial="calculated"', unit[1], ""),
    ]
    rows += [
        (n, 'causality="input"', unit[0], f' start="{u!r}"')
        for n, u in zip(names, first, strict=True)
    ]
    rows += [
        (
            entry.name,
            'causality="parameter"',
            f' min="{entry.low!r}" max="{entry.high!r}"',
            f' start="{entry.value!r}"',
        )
        for entry in source.entries
    ]
    common = 'name="{}" valueReference="{}" {} variability="{}"'
    variables, dt = "", DIALECTS["float64"].literal(source.dt)
    # fmu.c has the same value references
    for k, (variable, role, details, start) in enumerate(rows):
        variability = "tunable" if "parameter" in role else "continuous"
        attributes = common.format(variable, k, role, variability)
        variables += (
            f"    <Float64 {attributes}{details}{start}/>\n"
            if version == "3.0"
            else f"    <ScalarVariable {attributes}><Real{details}{start}/></ScalarVariable>\n"
        )
    by_version = {
        "2.0": {
            "token": "guid",
            "can": 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"\n'
            '      canNotUseMemoryManagementFunctions="true">\n',
            "sources": f'    <SourceFiles><File name="{name}.c"/><File name="{name}_fmu.c"/>'
            "</SourceFiles>\n  </CoSimulation>",
            "structure": '<Outputs><Unknown index="2" dependencies=""/></Outputs>\n'
            '    <InitialUnknowns><Unknown index="2" dependencies=""/></InitialUnknowns>',
        },
        "3.0": {
            "token": "instantiationToken",
            "can": 'canGetAndSetFMUState="true" canSerializeFMUState="true"\n'
            f'      fixedInternalStepSize="{dt}"/>',
            "sources": "",
            "structure": '<Output valueReference="1" dependencies=""/>\n'
            '    <InitialUnknown valueReference="1" dependencies=""/>',
        },
    }
    return _XML.substitute(
        by_version[version],
        name=name,
        version=version,
        what=class_name,
        digest=source.digest,
        units="".join(f"\n    <Unit name={quoteattr(u)}/>" for u in sorted({*units} - {None, "s"})),
        dt=dt,
        variables=variables,
    )


def _binaries(name, version, folder):
    """Return a dict with the libraries for this platform, and for Windows by a cross-compiler."""
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    targets = {("Windows", "x86_64"): shutil.which("x86_64-w64-mingw32-gcc")}
    targets |= {(platform.system(), machine): compiler}
    libraries = {}
    for (system, machine), compiler in targets.items():
        if not compiler or system not in _ENDINGS or (version == "2.0" and machine != "x86_64"):
            continue
        ending, system = _ENDINGS[system], system.lower()
        place = f"{machine}-{system}" if version == "3.0" else f"{system.removesuffix('dows')}64"
        library = Path(folder, name + ending)
        flags = ["-std=c99", "-O2", "-shared", "-fvisibility=hidden"]
        # without the date: equal models give equal files
        windows_flags = ["-static", "-s", "-Wl,--no-insert-timestamp"]
        flags += windows_flags if system == "windows" else ["-fPIC"]
        sources = [f"{name}.c", f"{name}_fmu.c"]
        result = subprocess.run(
            [compiler, *flags, "-o", library.name, *sources, "-lm"],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        if result.returncode:
            message = result.stderr.strip() or result.returncode
            raise OSError(f"{library.name} was not compiled: {message}")
        libraries[f"binaries/{place}/{library.name}"] = library.read_bytes()
    return libraries
