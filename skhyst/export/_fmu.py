"""Write a model as a functional mock-up unit: co-simulation around its C99 program."""

import platform
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from string import Template
from xml.sax.saxutils import quoteattr
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from .._files import replacing
from ._c import to_c

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
) -> Path:
    """Write a model, compensator or operator as a functional mock-up unit (FMU) for co-simulation.

    The FMU contains the C99 program of :func:`to_c` in double precision and, if a C compiler is
    found, a library for the present platform. Its state can be read, set and serialized.

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

    Returns
    -------
    Path
        The file.

    Raises
    ------
    NotImplementedError, TypeError, ValueError
        As :func:`to_c`.

    Notes
    -----
    Variables are ``time``, ``input`` (``input_1``, ``input_2``, ... if there are several) and
    ``output``. A communication step is one sampling interval: the input set before it is one
    sample, the output after it is the response to that sample, so in simulation time it appears one
    interval later. In a step of several intervals the input is held; steps of other sizes, and
    input that is not finite, are refused with an error.

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
    with tempfile.TemporaryDirectory() as folder:
        header, source, _ = to_c(model, folder, name, dt=dt, initial_state=initial_state, u0=u0)
        text = header.read_text()
        said = dict(re.findall(rf"#define {name}_(\w+) (\S+)", text))
        if said["DT"] == "NAN":
            raise ValueError("The 'dt' parameter of to_fmu must be given, in s.")
        first = (np.zeros(int(said["N_INPUTS"])) + u0).tolist()
        u = "u" if "const double *u" in text else "u[0]"
        wrapper = Path(folder, f"{name}_fmu.c")
        template = Template(Path(__file__).with_name("fmu.c").read_text())
        listed = ", ".join(map(repr, first))
        wrapper.write_text(
            template.substitute(name=name, version=version, major=version[0], first=listed, u=u)
        )
        files = {f"sources/{file.name}": file.read_bytes() for file in (header, source, wrapper)}
        files["modelDescription.xml"] = _description(
            name, version, type(model).__name__, said, first, (input_unit, output_unit)
        ).encode()
        if version == "3.0":
            files["sources/buildDescription.xml"] = _BUILD.substitute(name=name).encode()
        files |= _binary(name, version, folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as (part,), ZipFile(part, "w") as archive:
        for (
            file,
            content,
        ) in files.items():  # without the date, so that equal models give equal files
            archive.writestr(ZipInfo(file), content, ZIP_DEFLATED)
    return path


def _description(name, version, what, said, first, units):
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
    common = 'name="{}" valueReference="{}" {} variability="continuous"'
    variables = ""
    for k, (variable, role, of, start) in enumerate(rows):
        attributes = common.format(variable, k, role)
        variables += (
            f"    <Float64 {attributes}{of}{start}/>\n"
            if version == "3.0"
            else f"    <ScalarVariable {attributes}><Real{of}{start}/></ScalarVariable>\n"
        )
    own = {
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
            f'      fixedInternalStepSize="{said["DT"]}"/>',
            "sources": "",
            "structure": '<Output valueReference="1" dependencies=""/>\n'
            '    <InitialUnknown valueReference="1" dependencies=""/>',
        },
    }
    return _XML.substitute(
        own[version],
        name=name,
        version=version,
        what=what,
        digest=said["HASH"].strip('"'),
        units="".join(f"\n    <Unit name={quoteattr(u)}/>" for u in sorted({*units} - {None, "s"})),
        dt=said["DT"],
        variables=variables,
    )


def _binary(name, version, folder):
    """Return a dict with the library for this platform; empty without a compiler or if unknown."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    system, ending = {
        "Linux": ("linux", ".so"),
        "Darwin": ("darwin", ".dylib"),
        "Windows": ("windows", ".dll"),
    }.get(platform.system(), (None, None))
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    if not (compiler and system) or (version == "2.0" and machine != "x86_64"):
        return {}
    place = f"{machine}-{system}" if version == "3.0" else f"{system.removesuffix('dows')}64"
    library = Path(folder, name + ending)
    flags = ["-std=c99", "-O2", "-shared", "-fvisibility=hidden"]
    flags += [] if system == "windows" else ["-fPIC"]
    sources = [f"{name}.c", f"{name}_fmu.c"]
    done = subprocess.run(
        [compiler, *flags, "-o", library.name, *sources, "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise OSError(f"{library.name} was not compiled: {done.stderr.strip() or done.returncode}")
    return {f"binaries/{place}/{library.name}": library.read_bytes()}
