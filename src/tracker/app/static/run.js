// The run: start, progress, cancel, and the recommended numbers with the report.

import { get, post } from "/static/api.js";

const element = (id) => document.getElementById(id);
const cell = (kind, text) => Object.assign(document.createElement(kind), { textContent: text });

const DOING = { calibrate: "Measuring the scale", measure: "Measuring", combine: "Combined set", find: "Search", generate: "Making a dataset" };
const COMPARES = ["combine", "find"]; // their state stands beside their buttons
const STARTERS = ["run", "calibrate", "perspective", "combine", "search"];

export class Run {
  constructor(pointing, mending, arrows, tell, whenDone) {
    Object.assign(this, { pointing, mending, arrows, tell, whenDone, shown: "", began: null });
    setInterval(() => this.showTime(), 1000);
    element("run").addEventListener("click", () => this.start("/api/run"));
    element("calibrate").addEventListener("click", () => this.start("/api/calibrate"));
    element("perspective").addEventListener("click", () => {
      this.start("/api/calibrate", () => ({ ...pointing.collect(), points: pointing.knownPoints }));
    });
    element("combine").addEventListener("click", () => this.start("/api/combine", () => null));
    element("search").addEventListener("click", () => this.start("/api/search", () => element("model").value.trim()));
    element("cancel").addEventListener("click", () => post("/api/cancel").catch((error) => tell(error.message)));
  }

  async start(address, collect = () => this.pointing.collect()) {
    this.disable(true);
    try {
      this.show(await post(address, collect()));
    } catch (error) {
      this.disable(false);
      const places = { "/api/calibrate": "settings-error", "/api/combine": "compare-state", "/api/search": "compare-state" };
      const refused = !places[address] && element("settings-error").textContent === error.message;
      element(places[address] ?? "run-state").textContent = refused ? "Not started: see the message below the settings." : error.message;
    }
  }

  disable(disabled) { for (const id of STARTERS) element(id).disabled = disabled; }

  // After the page is loaded again: what has ended is part of the film's description.
  open({ results, search, has_film: hasFilm, status: { run } }) {
    if (run.state === "done") this.shown = `${run.command} ${run.number}`;
    element("run").textContent = hasFilm ? "Track" : "Measure again";
    element("settings").hidden = !hasFilm;
    if (results != null) this.showResults(results);
    if (search != null) this.arrows.load(search);
  }

  // How long a run has taken, which also tells that it is alive while it has nothing to count.
  showTime() {
    const now = this.began == null ? null : Math.round((performance.now() - this.began) / 1000);
    element("run-time").textContent = now ? `${now} s${this.left == null ? "" : `, about ${this.left} s left`}` : "";
  }

  show({ run, page, seconds }) {
    const running = run.state === "running", progress = element("progress");
    this.disable(running);
    element("cancel").hidden = progress.hidden = !running;
    if (running && run.total) {
      progress.max = run.total;
      progress.value = run.done;
    } else {
      progress.removeAttribute("value");
    }
    this.began = running && seconds != null ? performance.now() - 1000 * seconds : null;
    this.left = run.left_s;
    this.showTime();
    const looks = run.command === "track" ? ": looking through the film" : "";
    const counted = run.total ? ` ${run.done} of ${run.total} ${run.what}` : looks;
    const calibrates = run.command === "calibrate", stage = run.command === "find" ? ` ${run.lines.at(-1) ?? ""}` : "";
    const doing = (DOING[run.command] ?? "Tracking") + stage, done = calibrates ? "The film has a camera file now." : "Done.";
    const failed = `${run.error}${calibrates ? ". Set the scale by two points of a known distance instead, or by four known points." : ""}`;
    const words = { idle: "", running: `${doing}${counted}`, done, cancelled: "Cancelled.", failed };
    const place = COMPARES.includes(run.command) ? "compare-state" : "run-state";
    for (const id of ["run-state", "compare-state"]) {
      element(id).textContent = id === place ? words[run.state] : "";
      element(id).className = run.state === "failed" ? "error" : "";
    }
    element("log-box").hidden = run.lines.length === 0;
    element("log").replaceChildren(...run.lines.map((line) => cell("li", line)));
    if (run.state === "done" && this.shown !== `${run.command} ${run.number}`) {
      this.shown = `${run.command} ${run.number}`;
      if (run.command === "find") this.arrows.load(run.number);
      if (this.whenDone[run.command]) this.whenDone[run.command]();
      else if (page) this.showReport(page, DOING[run.command], true);
      else this.showResults(run.number);
    }
  }

  async showResults(number) {
    let found;
    try {
      found = await get(`/api/results/${number}`);
    } catch (error) {
      this.tell(error.message);
      return;
    }
    const parts = found.collisions.flatMap((collision) => this.describe(collision));
    if (found.more) parts.push(cell("p", `${found.more} more collisions are in the report.`));
    parts.push(Object.assign(cell("p", `Written to ${found.folder}`), { className: "note" }));
    if (found.page) parts.push(Object.assign(cell("a", "Report below"), { href: "#report-box" }));
    element("results").replaceChildren(...parts);
    this.pointing.send(); // the next run has another folder
    this.mending.load();
    element("compare-box").hidden = false;
    this.showReport(found.page, "Report");
  }

  showReport(page, title, wanted = false) {
    element("report-box").hidden = !page;
    if (wanted) element("report-box").scrollIntoView(); // far below its button
    element("report-title").textContent = title;
    if (page) element("report").src = page;
  }

  // Another clip has other tracks.
  clear() {
    this.mending.clear();
    element("report-box").hidden = true;
    element("results").replaceChildren();
    element("report").removeAttribute("src");
  }

  describe({ title, status, why, method, rows }) {
    const status_line = cell("p", `${title}: ${status}.`);
    const note = why ? [Object.assign(cell("p", `${why}.`), { className: "note" })] : [];
    if (rows.length === 0) return [status_line, ...note];
    const table = document.createElement("table"), head = document.createElement("tr");
    head.append(...["", method, "", "meaning"].map((text) => Object.assign(cell("th", text), { scope: "col" })));
    table.append(cell("caption", `${title}: ${status}`), head);
    for (const [symbol, value, unit, meaning] of rows) {
      const row = document.createElement("tr");
      row.append(cell("td", symbol), cell("td", value), cell("td", unit), cell("td", meaning));
      table.append(row);
    }
    return [table, ...note];
  }
}
