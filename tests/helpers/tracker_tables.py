"""Tracks written as other programs write them, typed from their files' shape: nothing of the tracker's own writers.

Rows are (frame, ball, x, y), px, pixel centres at whole numbers, y downwards.
"""

import itertools

SCALE = 3e-4  # m/px
SIZE = (200, 160)
FPS = 250.0
MIDDLE = ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)


def plain(rows, comma=",", point="."):
    lines = [comma.join(["frame", "particle", "x", "y"])]
    lines += [comma.join([f"{f}", f"{b}", f"{x:.9f}".replace(".", point), f"{y:.9f}".replace(".", point)])
              for f, b, x, y in rows]  # fmt: skip
    return "\n".join(lines) + "\n"


def trackmate_csv(rows, heads=4):
    """Microns, as of a calibrated image; a spot in no track last."""
    names = "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS,VISIBILITY"
    lines = [
        names,
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius,Visibility",
        "Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R,Visibility",
        ",,,(quality),(micron),(micron),(micron),(sec),,(micron),",
    ][:heads]
    um = SCALE * 1e6 if heads == 4 else 1.0
    for k, (f, b, x, y) in enumerate(rows):
        lines.append(f"ID{k},{k},{b},9.5,{x * um:.9f},{y * um:.9f},0.0,{f / FPS},{f},4.0,1")
    lines.append(f"ID{len(rows)},{len(rows)},,3.5,10.0,10.0,0.0,0.0,0,4.0,1")
    return "\n".join(lines) + "\n"


def trackmate_model(rows):
    """Microns; edges in no order; a third track that the user's filter left out, and a spot of none."""
    um = SCALE * 1e6
    spot = '<Spot ID="{}" name="s" QUALITY="1.0" POSITION_T="0.0" POSITION_X="{}" POSITION_Y="{}" FRAME="{}" />'
    spots = [spot.format(k, x * um, y * um, f) for k, (f, b, x, y) in enumerate(rows)]
    spots += [spot.format(900 + k, 5.0, 5.0, k) for k in range(3)]
    tracks = {2: "".join('<Edge SPOT_SOURCE_ID="900" SPOT_TARGET_ID="901" LINK_COST="1.0" />' for _ in range(1))}
    for ball in (0, 1):
        own = [k for k, row in enumerate(rows) if row[1] == ball]
        edges = [f'<Edge SPOT_SOURCE_ID="{a}" SPOT_TARGET_ID="{b}" />' for a, b in itertools.pairwise(own)]
        tracks[ball] = "".join(reversed(edges))
    inner = "".join(f'<Track name="t" TRACK_ID="{n}">{edges}</Track>' for n, edges in tracks.items())
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<TrackMate version="7.11.1"><Log>none</Log>'
        '<Model spatialunits="micron" timeunits="sec">'
        f'<AllSpots nspots="{len(spots)}"><SpotsInFrame frame="0">{"".join(spots)}</SpotsInFrame></AllSpots>'
        f"<AllTracks>{inner}</AllTracks>"
        '<FilteredTracks><TrackID TRACK_ID="0" /><TrackID TRACK_ID="1" /></FilteredTracks></Model>'
        f'<Settings><ImageData filename="a.tif" pixelwidth="{um}" timeinterval="{1 / FPS}" /></Settings></TrackMate>'
    )


def _particles(rows):
    out = []
    for ball in (0, 1):
        own = "".join(f'<detection t="{f}" x="{x}" y="{y}" z="0" />' for f, b, x, y in rows if b == ball)
        out.append(f"<particle>{own}</particle>")
    return "".join(out)


def trackmate_tracks(rows):
    head = f'<Tracks nTracks="2" spaceUnits="pixel" frameInterval="{1 / FPS}" timeUnits="sec" from="TrackMate v7.12">'
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{head}{_particles(rows)}</Tracks>'


def ptc(rows):
    head = '<TrackContestISBI2012 SNR="7" density="low" scenario="VESICLE">'
    return f"<?xml version='1.0' encoding='ISO-8859-1'?><root>{head}{_particles(rows)}</TrackContestISBI2012></root>"


def mot(rows, side=7.9):
    """Boxes counted from 1: the picture's corner, half a pixel from the first one's centre, is (1, 1)."""
    corner = 1.5 - side / 2
    return "".join(
        f"{f + 1},{b + 1},{x + corner},{y + corner},{side},{side},1,-1,-1,-1\n" for f, b, x, y in rows
    )  # fmt: skip


def osp_marks(rows):
    """A .trk file: the picture's corner is (0, 0)."""
    masses = []
    for ball in (0, 1):
        marks = "".join(
            f'<property name="[{f}]" type="object"><object class="org.opensourcephysics.cabrillo.tracker.PointMass'
            f'$FrameData"><property name="x" type="double">{x + 0.5}</property>'
            f'<property name="y" type="double">{y + 0.5}</property></object></property>'
            for f, b, x, y in rows if b == ball
        )  # fmt: skip
        masses.append(
            '<property name="item" type="object"><object class="org.opensourcephysics.cabrillo.tracker.PointMass">'
            f'<property name="mass" type="double">1.0</property><property name="name" type="string">m{ball}</property>'
            f'<property name="framedata" type="array">{marks}</property></object></property>'
        )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<object class="org.opensourcephysics.cabrillo.tracker.TrackerPanel">'
        f'<property name="clipcontrol" type="object"><object class="x"><property name="delta_t" type="double">'
        f'{1e3 / FPS}</property></object></property><property name="tracks" type="collection">{"".join(masses)}'
        "</property></object>"
    )


def osp_table(rows, comma="\t", point=".", late=lambda frame: 0.0, scale=SCALE):
    """Two masses beside each other, metres from axes in the picture's middle, y up; lines end in a delimiter."""
    by = {(f, b): (x, y) for f, b, x, y in rows}

    def number(value):
        return f"{value:.9E}".replace(".", point)

    lines = ["#multi:", comma.join(["", "mass A", "", "mass B", "", ""]), comma.join(["t", "x", "y", "x", "y", ""])]
    for frame in sorted({f for f, _ in by}):
        cells = [number(frame / FPS + late(frame))]
        for ball in (0, 1):
            place = by.get((frame, ball))
            cells += ["", ""] if place is None else [
                number((place[0] - MIDDLE[0]) * scale), number((MIDDLE[1] - place[1]) * scale)
            ]  # fmt: skip
        lines.append(comma.join([*cells, ""]))
    return "\n".join(lines) + "\n"
