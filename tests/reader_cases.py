"""Files for readers, right and wrong ones: what OpenSim reads them as is recorded, and ours is compared.

`record_opensim_readers.py` writes them with an interpreter that has OpenSim, the tests with one that has not;
so nothing but Python's own modules is used here, and every case has its own generator of random numbers.
"""

import random
import re

ROWS = "".join(f"{0.01 * k:.2f}\t{12.5 + 0.75 * k:.3f}\t{-3.25 * k:.4f}\n" for k in range(1, 7))
NAMES = "time\tr_shoulder_elev\tr_elbow_flex\n"
FIRST = f"walk\nversion=1\nnRows=6\nnColumns=3\ninDegrees=yes\nendheader\n{NAMES}{ROWS}"
THIRD = f"inDegrees=no\nDataType=double\nversion=3\nOpenSimVersion=4.6\nendheader\n{NAMES}{ROWS}"
SIMM = f"name walk\ndatacolumns 3\ndatarows 6\nrange 0.01 0.06\nendheader\n{NAMES}{ROWS}"
MARKERS = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100.00\t100.00\t5\t2\tmm\t100.00\t1\t5\n"
    "Frame#\tTime\tHEEL\t\t\tTOE\t\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\t\n\n"
    + "".join(
        f"{k}\t{0.01 * k:.2f}\t{1000.25 + k}\t{20.5 - k}\t-30.125\t"
        + ("\t\t" if k == 3 else f"{7.5 * k}\t8.25\t{-9.0 + k}")
        + "\t\n"
        for k in range(1, 6)
    )
)

RIGHT = {"first.mot": FIRST, "first.sto": FIRST, "third.sto": THIRD, "simm.mot": SIMM, "markers.trc": MARKERS}

SETUPS = {
    "kinematics.xml": """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
<InverseKinematicsTool name="k">
<time_range>0.25 1.5</time_range>
<IKTaskSet>
<objects>
<IKMarkerTask name="HEEL">
<apply>true</apply>
<weight>2.5</weight>
</IKMarkerTask>
<IKMarkerTask name="TOE">
<apply>false</apply>
<weight>3</weight>
</IKMarkerTask>
</objects>
</IKTaskSet>
<marker_file>walk.trc</marker_file>
<coordinate_file>Unassigned</coordinate_file>
</InverseKinematicsTool>
</OpenSimDocument>
""",
    "dynamics.xml": """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
<InverseDynamicsTool name="d">
<time_range>0.25 1.5</time_range>
<external_loads_file>loads.xml</external_loads_file>
<coordinates_file>walk.mot</coordinates_file>
<lowpass_cutoff_frequency_for_coordinates>6.5</lowpass_cutoff_frequency_for_coordinates>
</InverseDynamicsTool>
</OpenSimDocument>
""",
    "analysis.xml": """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
<AnalyzeTool name="a">
<initial_time>0.25</initial_time>
<final_time>1.5</final_time>
<external_loads_file>loads.xml</external_loads_file>
<coordinates_file>walk.mot</coordinates_file>
<lowpass_cutoff_frequency_for_coordinates>6.5</lowpass_cutoff_frequency_for_coordinates>
</AnalyzeTool>
</OpenSimDocument>
""",
    "scaling.xml": """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
<ScaleTool name="s">
<mass>72.5</mass>
<ModelScaler>
<apply>true</apply>
<scaling_order>measurements manualScale</scaling_order>
<marker_file>static.trc</marker_file>
<time_range>0.5 0.75</time_range>
<preserve_mass_distribution>true</preserve_mass_distribution>
</ModelScaler>
<MarkerPlacer>
<apply>false</apply>
<marker_file>static.trc</marker_file>
<time_range>-1 -1</time_range>
</MarkerPlacer>
</ScaleTool>
</OpenSimDocument>
""",
    "loads.xml": """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
<ExternalLoads name="l">
<objects>
<ExternalForce name="right">
<appliesForce>true</appliesForce>
<applied_to_body>calcn_r</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>r_v</force_identifier>
<point_identifier>r_p</point_identifier>
<torque_identifier>r_t</torque_identifier>
</ExternalForce>
</objects>
<datafile>forces.mot</datafile>
</ExternalLoads>
</OpenSimDocument>
""",
}
STATED = (
    "Unassigned",
    "",
    " ",
    "-1 -1",
    "-Inf Inf",
    "inf",
    "nan",
    "1",
    "0.5 2",
    "0.1 0.2 0.3",
    "true",
    "False",
    "0.4 0.1",
)
STATED += (
    "-1",
    "1_0",
    "0.25e1",
    "/bodyset/calcn_r",
    "/ground",
    "0",
    "TRUE",
    "yes",
    "1,5",
    "a b",
    "../walk.mot",
)
TABLE = """trial,model,motion,filter,max_isometric_force,mass_spread
a,arm.osim,bend.mot,6.5,1.25,0.125
b,arm.osim,bend.mot,,0.75,0.25
c,leg.osim,walk.mot,12,2,0
"""

HEADERS = [
    f"walk\nversion=1\nnRows=6\nnColumns=3\n{line}"
    for line in (
        *(
            "inDegrees=yes",
            "inDegrees=no",
            "inDegrees = yes",
            "inDegrees\tyes",
            "inDegrees yes",
            "inDegrees=y",
        ),
        *("inDegrees=Y", "inDegrees=YES", "inDegrees=yeah", "inDegrees=n", "inDegrees=true", "inDegrees=1"),
        *(
            "inDegrees=",
            "InDegrees=yes",
            "indegrees=yes",
            "inDegrees==yes",
            " inDegrees=yes",
            "inDegrees:yes",
        ),
        *(
            "inDegrees=yes\t\t",
            "inDegrees=yes,,",
            "inDegrees=yes\ninDegrees=no",
            "Angles are in degrees.",
            "",
        ),
    )
]
HEADERS += [
    f"walk\nnRows=6\nnColumns=3\n{line}"
    for line in (
        *(
            "",
            "inDegrees=no",
            "inDegrees=yes",
            "Angles are in degrees.",
            "Angles are in radians.",
            "version=0",
        ),
        *("version=0\ninDegrees=no", "version", "version=1.5", "version 1", "Version=1", "version=x"),
    )
]
HEADERS += [
    "name walk\ndatacolumns 3\ndatarows 6\nrange 0 1",
    "walk\nnr 6\nnc 3",
    "walk\nnr=6\nnc=3\nversion=1",
]
HEADERS += [
    f"DataType=double\nversion=3\nOpenSimVersion=4.6{line}"
    for line in ("", "\ninDegrees=yes", "\ninDegrees=no", "\ninDegrees = yes", "\nindegrees=yes")
]

WORDS = (
    "nan",
    "NaN",
    "inf",
    "1e308",
    "-1e308",
    "1e15",
    "1_0",
    "\u0663",
    "0x10",
    "1,5",
    "x",
    "",
    "1 2",
    "-",
    "+3",
)
WORDS += ("1.0D+00", "-1.#IND", "1e", ".5", "3.", "1.5f", "0", "1e-8", "0.03", "0.0200000001", "00.02")
LETTERS = "0123456789.-+eE,;_=\t \nxaI#\"'\u0663\u00e4"
LINES = (
    *(
        "nRows=5",
        "nRows=7",
        "nRows=0",
        "nRows=six",
        "nColumns=2",
        "nColumns=4",
        "inDegrees=no",
        "inDegrees=YES",
    ),
    *(
        "inDegrees=on",
        "version=0",
        "version=2",
        "datarows 6",
        "Angles are in radians.",
        "endheader",
        "",
        "\t",
    ),
)


def mutated(text, number, mutations=None):
    """Return a text with one or two things wrong, the same for a number always."""
    chance = random.Random(number)
    for _ in range(chance.choice((1, 1, 1, 2))):
        text = chance.choice(mutations or MUTATIONS)(text, chance)
    return text


def at(text, chance):
    """Return a place in a text."""
    return chance.randrange(len(text)) if text else 0


def letter_gone(text, chance):
    """Leave out a letter."""
    place = at(text, chance)
    return text[:place] + text[place + 1 :]


def letter_more(text, chance):
    """Put in a letter."""
    place = at(text, chance)
    return text[:place] + chance.choice(LETTERS) + text[place:]


def letter_other(text, chance):
    """Put a letter in another's place."""
    place = at(text, chance)
    return text[:place] + chance.choice(LETTERS) + text[place + 1 :]


def line_gone(text, chance):
    """Leave out a line."""
    lines = text.splitlines(keepends=True)
    del lines[at(lines, chance)]
    return "".join(lines)


def line_twice(text, chance):
    """Repeat a line."""
    lines = text.splitlines(keepends=True)
    lines.insert(at(lines, chance), lines[at(lines, chance)])
    return "".join(lines)


def lines_swapped(text, chance):
    """Swap two lines."""
    lines = text.splitlines(keepends=True)
    one, other = at(lines, chance), at(lines, chance)
    lines[one], lines[other] = lines[other], lines[one]
    return "".join(lines)


def line_other(text, chance):
    """Put another line of a header in a line's place, near the beginning."""
    lines = text.splitlines(keepends=True)
    lines[chance.randrange(min(6, len(lines)))] = chance.choice(LINES) + "\n"
    return "".join(lines)


def cell_other(text, chance):
    """Put a word in a cell's place."""
    cells = re.split(r"([\t\n])", text)
    place = 2 * chance.randrange(len(cells) // 2 + 1)
    cells[place] = chance.choice(WORDS)
    return "".join(cells)


def cell_gone(text, chance):
    """Leave out a cell and what ends it."""
    cells = re.split(r"([\t\n])", text)
    place = 2 * chance.randrange(len(cells) // 2 + 1)
    del cells[place : place + 2]
    return "".join(cells)


def number_other(text, chance):
    """Put another number in a number's place."""
    found = list(re.finditer(r"-?\d+(\.\d+)?", text))
    if not found:
        return text
    one = chance.choice(found)
    return (
        text[: one.start()]
        + chance.choice(("7", "-1.5", "0.035", "1e3", "12.3456789012"))
        + text[one.end() :]
    )


def cut(text, chance):
    """End the file somewhere."""
    return text[: at(text, chance)]


def ends(text, chance):
    """Write other ends of lines, or blanks for tabs."""
    return text.replace(*chance.choice((("\n", "\r\n"), ("\t", "  "), ("\n", "\t\n"), ("\t", " \t"))))


MUTATIONS = (
    *(letter_gone, letter_more, letter_other, line_gone, line_twice, lines_swapped, line_other, cell_other),
    *(cell_other, cell_gone, number_other, number_other, cut, ends),
)


def recordings():
    """Yield name and text of wrong recordings, each in a right file's format."""
    for number in range(1500):
        name, text = list(RIGHT.items())[number % len(RIGHT)]
        yield f"{number}{name[-4:]}", mutated(text, number)


def element_other(text, chance):
    """Put a word in the place of what an element of a set-up file says."""
    one = chance.choice(list(re.finditer(r">([^<>\n]*)</", text)))
    return text[: one.start(1)] + chance.choice(STATED) + text[one.end(1) :]


def element_empty(text, chance):
    """Write an element of a set-up file as an empty one."""
    one = chance.choice(list(re.finditer(r"<(\w+)>[^<>\n]*</\w+>", text)))
    return text[: one.start()] + f"<{one[1]}/>" + text[one.end() :]


def setups():
    """Yield name and text of wrong set-up files."""
    mutations = (
        element_other,
        element_other,
        element_other,
        element_empty,
        line_gone,
        *MUTATIONS[:6],
        number_other,
    )
    for number in range(300):
        name, text = list(SETUPS.items())[number % len(SETUPS)]
        yield f"{number}{name}", mutated(text, number, mutations)


def tables():
    """Yield wrong tables of a study."""
    for number in range(200):
        yield mutated(TABLE.replace(",", "\t"), number).replace("\t", ",")
