"""Tables of tracks in the dialects of programs, each written from the same rows (frame, ball, x, y), px.

Balls are 0 and 1, and each frame shows both.
"""


def write_lines(rows, mark=",", point=".", head="frame,particle,x,y", digits=".3f"):
    def number(value):
        return format(value, digits).replace(".", point)

    body = [mark.join([f"{f}", f"{b}", number(x), number(y)]) for f, b, x, y in rows]
    return "\n".join([*([head.replace(",", mark)] if head else []), *body]) + "\n"


def write_late_decimals(rows):
    """Whole numbers stand without decimals, so that the first decimal comma may come late."""
    text = [f"{f};{b};{x:g};{y:g}".replace(".", ",") for f, b, x, y in rows]
    return "frame;particle;x;y\n" + "\n".join(text)


def write_savetxt(rows, header="frame particle x y"):
    return f"# {header}\n" + "".join(f"{f:.18e} {b:.18e} {x:.18e} {y:.18e}\n" for f, b, x, y in rows)


def write_trackpy_without_header(rows):
    """As DataFrame.to_csv(header=False, sep=tab, decimal=comma) of trackpy writes: index, x, y, mass, ..."""
    extra = [f"{1000.5 + k}\t4.17\t0.21" for k in range(len(rows))]
    lines = [f"{k}\t{x}\t{y}\t{extra[k]}\t{f}\t{b}" for k, (f, b, x, y) in enumerate(rows)]
    return "\n".join(lines).replace(".", ",")


def pair_balls(rows, mark=","):
    """The frames in order, and x and y of each (frame, ball) as text."""
    return sorted({f for f, *_ in rows}), {(f, b): f"{x}{mark}{y}" for f, b, x, y in rows}


def write_wide(rows, head="seconds,x1,y1,x2,y2", mark=",", first=lambda f: f"{f / 250:g}"):
    frames, by = pair_balls(rows, mark)
    return (head + "\n" if head else "") + "".join(mark.join([first(f), by[f, 0], by[f, 1]]) + "\n" for f in frames)


def write_idtracker(rows):
    return write_wide(rows, "X1\tY1\tX2\tY2", "\t", lambda f: "").replace("\n\t", "\n")


def write_deeplabcut(rows, individuals=True):
    heads = ["scorer," + ",".join(["net"] * 6)]
    if individuals:
        heads.append("individuals,a,a,a,b,b,b")
        heads.append("bodyparts" + ",centre" * 6)
    else:
        heads.append("bodyparts,a,a,a,b,b,b")
    heads.append("coords,x,y,likelihood,x,y,likelihood")
    frames, by = pair_balls(rows)
    return "\n".join([*heads, *(f"{f},{by[f, 0]},0.99,{by[f, 1]},0.99" for f in frames)]) + "\n"


def write_german_trackmate(rows, unit="(pixel)"):
    head = ["LABEL;ID;TRACK_ID;POSITION_X;POSITION_Y;FRAME", "Label;ID;Track;X;Y;Frame", "Label;ID;Track;X;Y;Frame"]
    lines = [f"ID{k};{k};{b};{x:.3f};{y:.3f};{f}".replace(".", ",") for k, (f, b, x, y) in enumerate(rows)]
    return "\n".join([*head, f";;;{unit};{unit};", *lines])


def write_trackmate_xml(rows, unit):
    inner = ""
    for ball in (0, 1):
        own = "".join(f'<detection t="{f}" x="{x}" y="{y}" z="0"/>' for f, b, x, y in rows if b == ball)
        inner += f"<particle>{own}</particle>"
    return f'<Tracks nTracks="2" spaceUnits="{unit}" frameInterval="0.004" timeUnits="sec">{inner}</Tracks>'


def write_mot(rows, first=0, confidence=0):
    return "".join(f"{f + first} {b + 1} {x - 5 + 1.5} {y - 5 + 1.5} 10 10 {confidence} -1 -1\n" for f, b, x, y in rows)


def write_quoted(rows):
    body = [f'{f},{b},"{x}","{y}"'.replace(".", ",") for f, b, x, y in rows]
    return "\n".join(["frame,particle,x,y", *body])


def write_missing(rows, marks=("-", "", "NA", "--", "nan", "None", "?"), first=2):
    """Ball 1 is lost in a frame for each mark, from frame `first` on."""
    text = write_lines(rows)
    for f, mark in enumerate(marks, first):
        text = "\n".join(f"{f},1,{mark},{mark}" if line.startswith(f"{f},1,") else line for line in text.split("\n"))
    return text


def write_qualisys(rows, size, names=True, lost=None, scale=0.16):
    """Millimetres on a plate, by a scale in mm/px, z up; 0, 0, 0 where a marker is lost, at (frame, ball)."""
    middle = [(n - 1) / 2 for n in size]
    by = {
        (f, b): f"{(x - middle[0]) * scale:.6f}\t{(middle[1] - y) * scale:.6f}\t1.190" for f, b, x, y in rows
    }  # fmt: skip
    by[lost] = "0.000\t0.000\t0.000"
    frames = sorted({f for f, *_ in rows})
    head = f"NO_OF_FRAMES\t{len(frames)}\nNO_OF_MARKERS\t2\nFREQUENCY\t250\nDATA_INCLUDED\t3D\nMARKER_NAMES\tA\tB\n"
    head += "Frame\tTime\tA X\tA Y\tA Z\tB X\tB Y\tB Z\n" if names else ""
    return head + "".join(
        (f"{f + 1}\t{f / 250:.5f}\t" if names else "") + f"{by[f, 0]}\t{by[f, 1]}\n" for f in frames
    )  # fmt: skip


def list_dialects(rows):
    """Texts by the name of their dialect: all hold the positions of the rows, and no others."""
    plain = write_lines(rows)
    return {
        "sep=": "sep=;\n" + write_lines(rows, mark=";"),
        "comments": "# made by lab software 3.1\n% fps 250\n" + plain,
        "comment between": plain.replace("\n3,", "\n# paused\n\n3,", 1),
        "blanks": write_lines(rows, mark=", "),
        "names with units": write_lines(rows, head='frame,particle,"x, px","y, px"'),
        "names in brackets": write_lines(rows, head="Frame,Particle,X (px),Y [px]"),
        "other names": write_lines(rows, head="frame_number,track_id,pos_x,pos_y"),
        "quoted": write_lines(rows, head='"frame","particle","x","y"'),
        "savetxt": write_savetxt(rows),
        "savetxt, no names": write_savetxt(rows, "fps 250"),
        "padded columns": "frame particle x y\n" + "".join(f"{f:6d}{b:6d}{x:14.3f}{y:14.3f}\n" for f, b, x, y in rows),
        "no names": write_lines(rows, head="", mark="\t"),
        "no names, trackpy": write_trackpy_without_header(rows),
        "pipes": write_lines(rows, mark=" | "),
        "blanks, decimal comma": write_lines(rows, mark=" ", point=","),
        "quoted decimal comma": write_quoted(rows),
        "trailing delimiters": plain.replace("\n", ",\n"),
        "trailing delimiters but names": plain.replace("\n", ",\n").replace("y,\n", "y\n", 1),
        "row numbers without a name": plain.replace("\n", "\n7,").removesuffix("7,"),
        "ids of -1": plain + "3,-1,17.5,18.5\n4,-1,600.5,1.5\n",
        "names of balls": plain.replace(",0,", ",left,").replace(",1,", ",right,"),
        "wide": write_wide(rows),
        "wide, idTracker": write_idtracker(rows),
        "wide, named": write_wide(rows, "frame,red_x,red_y,blue_x,blue_y", first=str),
        "DeepLabCut": write_deeplabcut(rows),
        "DeepLabCut, one animal": write_deeplabcut(rows, individuals=False),
        "German TrackMate": write_german_trackmate(rows),
        "TrackMate without unit": write_german_trackmate(rows, "()"),
        "TrackMate, unit": write_trackmate_xml(rows, "unit"),
        "TrackMate, a.u.": write_trackmate_xml(rows, "a.u."),
        "TrackMate, no unit": write_trackmate_xml(rows, ""),
        "MOT from 0": write_mot(rows),
        "MOT, confidence 0": write_mot(rows, 1),
    }  # fmt: skip
