"""The page and the files of a gas: temperature, energies, velocities and pair correlation, beside theory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.outputs import replace_folder, write_atomically
from synthcam_shared.report.numbers import format_number, format_with_error
from synthcam_shared.report.page import PageFigure, PageList, PageSection, PageTable, make_axes, write_page
from tracker.gas.energy import SINKS
from tracker.gas.gas import GasObservables, contact_pair_correlation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLES = {"time": "time.csv", "pairs": "pairs.csv", "velocities": "velocities.csv"}
FILES = ("gas.json", "index.html", *TABLES.values())
COLOURS = {"contacts": "#c1440e", "walls": "#7a7a7a", "plate": "#14508c", "unresolved": "#c9b458"}
WORDS = {"contacts": "contacts of balls", "walls": "walls", "plate": "plate", "unresolved": "not resolved"}
QUANTITIES = {  # name: words, unit, factor
    "contacts": ("contacts of two balls", "", 1.0),
    "contact_rate": ("contacts of a ball per second", "1/s", 1.0),
    "free_path": ("mean free path", "mm", 1e3),
    "sonine_a2": ("Sonine coefficient a2", "", 1.0),
}
METHOD = (
    "The temperature T is the variance of one component of the velocities about their mean, per unit mass. A velocity "
    "is that of parabolas through the even and through the odd positions near an instant. The product of both has no "
    "noise, if errors of neighbouring frames are independent.",
    "The error bar of T is that of the noise. The band has the further error of a temperature from so few balls.",
    "On a free path a ball loses energy to the plate, because it slides and rolls. At a contact balls lose what "
    "the local estimate of the contact gives. Energy of rotation is not seen. Not resolved: the loss of a contact is "
    "not known, a free path has too few frames, or the ball was not seen.",
    "Contacts whose paths show no loss take what contacts with such a kick usually take.",
    "Theory: hard discs of the measured temperature and density, with a Maxwellian distribution (Enskog), and the pair "
    "correlation at contact of Henderson (1975).",
    "The pair correlation is corrected for the edges of the rectangle of the centres. Its errors are the scatter of 20 "
    "blocks of time.",
)


def write_gas(gas: GasObservables, folder: Path, command: str) -> Path:
    """Write gas.json, the tables and index.html into a folder, which replaces an earlier gas; return the page."""
    last, rows = gas.time.iloc[-1] * 1e3, []
    for name, share in _shares(gas).items():
        value, std = (last[f"{SINKS[name]}{end}"] for end in ("", "_std"))
        rows.append([WORDS[name], format_with_error(value, std), f"{100 * share:.1f}"])
    lost = PageTable(["lost to", "10⁻³ m²/s², all balls", "%"], rows, "Until the last frame, per unit mass")
    sections = [
        PageSection("", [_values_table(gas)]),
        PageSection("Temperature", [PageFigure.of(draw_temperature(gas), "Temperature against time")]),
        PageSection("Energy", [PageFigure.of(draw_energy_sinks(gas), "Energy lost against time"), lost]),
        PageSection(
            "Velocities and order",
            [PageFigure.of(draw_velocities_and_pair_correlation(gas), "Velocities and pair correlation")],
        ),
        PageSection("Method", [PageList(METHOD)]),
    ]
    title = "Temperature and energy of a gas of balls" + (f": {gas.name}" if gas.name else "")
    with replace_folder(folder, FILES, "an earlier gas of tracker gas") as aside:
        document = {"values": gas.values, "area": gas.area, "notes": list(gas.notes)}
        write_atomically(aside / FILES[0], json.dumps(replace_non_finite(document), indent=1) + "\n")
        for attribute, file in TABLES.items():
            write_atomically(aside / file, getattr(gas, attribute).to_csv(index=False, lineterminator="\n"))
        write_page(aside / FILES[1], title, sections, command, summarise_gas(gas), gas.notes)
    return folder / FILES[1]


def summarise_gas(gas: GasObservables) -> list[str]:
    """Summarise a gas in lines for a terminal: balls, temperature, contacts and energies."""
    time, values = gas.time, gas.values
    first, last = time.iloc[0], time.iloc[-1]
    shares = _shares(gas)
    lines = [
        f"{int(time['balls'].median())} balls in {len(time)} frames, area fraction {values['area_fraction']:.3f}.",
        f"Temperature {format_with_error(first['temperature'], first['temperature_std'])} at "
        f"{first['t_s']:.3g} s, {format_with_error(last['temperature'], last['temperature_std'])} m²/s² at "
        f"{last['t_s']:.3g} s.",
        f"{values['contacts']:.0f} contacts of two balls; hard discs would have {values['contacts_theory']:.0f}.",
    ]
    if np.isfinite(values["mu_k"]):
        lines.append(f"Friction of the plate mu_k = {format_with_error(values['mu_k'], values['mu_k_std'])}.")
    if shares:
        lines.append("Energy lost to " + ", ".join(f"{WORDS[k]} {100 * v:.1f} %" for k, v in shares.items()) + ".")
    return lines


def _shares(gas: GasObservables) -> dict[str, float]:
    """Share of each sink in the energy that was lost."""
    last = gas.time.iloc[-1]
    lost = {name: float(last[column]) for name, column in SINKS.items()}
    total = sum(lost.values())
    return {name: value / total for name, value in lost.items()} if total > 0 else {}


def _values_table(gas: GasObservables) -> PageTable:
    rows = []
    for name, (words, unit, factor) in QUANTITIES.items():
        value, std = gas.values[name] * factor, gas.values[f"{name}_std"] * factor
        theory = {"sonine_a2": 0.0, "contact_rate": np.nan}.get(name, gas.values.get(f"{name}_theory", np.nan) * factor)
        rows.append([words, unit, format_with_error(value, std), format_number(theory)])
    if np.isfinite(loss := gas.values["rolling_loss"]):
        words = f"loss of rolling or gliding at {format_number(gas.values['rolling_speed'])} m/s"
        rows.append([words, "m/s²", format_with_error(loss, gas.values["rolling_loss_std"]), format_number(np.nan)])
    if np.isfinite(friction := gas.values["mu_k"]):
        words = "friction of the plate, by slides on free paths"
        rows.append([words, "", format_with_error(friction, gas.values["mu_k_std"]), format_number(np.nan)])
    noise = gas.values["position_noise"] * 1e6
    note = (
        f"Noise of a coordinate {format_number(noise)} µm, {format_number(gas.values['noise_ratio'])} of what the "
        "tracks claim. 0.9027(12) means 0.9027 ± 0.0012, one standard error."
    )
    return PageTable(["quantity", "unit", "measured", "hard discs"], rows, "", note)


def draw_temperature(gas: GasObservables) -> Figure:
    """Draw the figure of a gas's temperature against time, with both errors."""
    figure, axes = make_axes(figsize=(7.2, 3.6))
    time = gas.time[gas.time["temperature"] > 0]
    t, value = time["t_s"], time["temperature"]
    spread = np.hypot(time["temperature_sampling"], time["temperature_std"])
    axes.fill_between(t, np.maximum(value - spread, value / 10), value + spread, color="0.85", lw=0, label="few balls")
    axes.plot(t, value, color=COLOURS["plate"], lw=0.8)
    some = time.iloc[:: max(len(time) // 40, 1)]
    points = {"fmt": "o", "ms": 2.5, "color": COLOURS["plate"], "label": "measured, ± noise"}
    axes.errorbar(some["t_s"], some["temperature"], some["temperature_std"], **points)
    axes.set(xlabel="t / s", ylabel="T / (m²/s²)", yscale="log")
    axes.legend(frameon=False)
    return figure


def draw_energy_sinks(gas: GasObservables) -> Figure:
    """Draw the figure of the energies that a gas has lost against time, one line for each sink."""
    figure, axes = make_axes(figsize=(7.2, 3.6))
    time = gas.time
    for name, column in SINKS.items():
        if name == "walls" and not (time[column] != 0).any():
            continue
        value, std = 1e3 * time[column], 1e3 * time[f"{column}_std"]
        axes.plot(time["t_s"], value, color=COLOURS[name], label=WORDS[name])
        axes.fill_between(time["t_s"], value - std, value + std, color=COLOURS[name], alpha=0.3, lw=0)
    axes.plot(time["t_s"], 1e3 * time["energy"], color="0.3", ls=":", label="left")
    axes.set(xlabel="t / s", ylabel="energy per unit mass / (10⁻³ m²/s²)")
    axes.legend(frameon=False)
    return figure


def draw_velocities_and_pair_correlation(gas: GasObservables) -> Figure:
    """Draw the distribution of velocities beside a Maxwellian, and the pair correlation beside theory."""
    figure, (left, right) = make_axes(1, 2, figsize=(9.6, 3.6))
    points = {"fmt": "o", "color": COLOURS["plate"], "label": "measured"}
    table, c = gas.velocities[gas.velocities["density"] > 0], np.linspace(-4, 4, 201)
    left.errorbar(table["c"], table["density"], table["density_std"], ms=3, **points)
    left.plot(c, np.exp(-(c**2) / 2) / np.sqrt(2 * np.pi), color="0.4", label="Maxwellian")
    limits: dict[str, Any] = {"ylim": (1e-4, 2)} if len(table) else {}
    left.set(xlabel="component of v / √T", ylabel="density", yscale="log", **limits)
    left.legend(frameon=False)
    pairs = gas.pairs
    right.errorbar(pairs["r"] / gas.diameter, pairs["g"], pairs["g_std"], ms=2.5, **points)
    right.axhline(1, color="0.6", lw=0.8)
    contact = float(contact_pair_correlation(gas.values["area_fraction"]))
    right.plot(1, contact, "s", color=COLOURS["contacts"], label="hard discs at contact")
    right.set(xlabel="distance / diameter", ylabel="pair correlation g", ylim=(0, None))
    right.legend(frameon=False)
    return figure
