"""The table as JSON and as Markdown."""

import statistics

from targets import ELSEWHERE, OWN, TARGETS

INTRODUCTION = """\
Every performance target of the project in one run on one machine, each beside its peer where there is one: other
libraries that do the same work (`benches/peers/README.md` describes their setup), or the paper's controller as this
program has it. Figures are the median and, in brackets, the range over repeats. Times are wall times unless the line states
otherwise, by the program's own clock, by criterion, or by the script that runs the peer; what one script compares takes
turns. The ratio is ours over the peer's: below 1 is better, except for *x real time*. Arms, sensors and paths are
**simulated**; lines marked *measured* are about logs of a real arm and of real IMUs. A line without a bound is there for
its peer, or to be known."""


def short(x: float) -> str:
    """Three digits, without exponents."""
    if x == 0 or not abs(x) < 1e15:
        return f"{x:g}"
    for digits, least in ((0, 100), (1, 10), (2, 1)):
        if abs(x) >= least:
            return f"{x:,.{digits}f}"
    return f"{x:.3g}" if abs(x) >= 1e-3 else f"{x:.1e}"


def spread(values, middle=None) -> dict:
    median = statistics.median(values) if middle is None else middle
    return {"median": median, "min": min(values), "max": max(values), "values": len(values)}


def in_words(s: dict) -> str:
    if s["min"] == s["max"]:
        return short(s["median"])
    return f"{short(s['median'])} ({short(s['min'])}-{short(s['max'])})"


def row(target, figure, why: str | None) -> dict:
    """One target with what was measured of it; `why`: what failed, where something did."""
    out = {
        "id": target.id,
        "section": target.section,
        "target": target.text,
        "unit": target.unit,
        "bound": target.bound(),
        "measured": None,
        "met": None,
        "peers": [],
        "note": f"no peer: {target.alone}" if target.alone not in ("", OWN) else "",
    }
    if figure is None or not figure.values:
        out["failed"] = why or "not measured"
        return out
    ours = spread(figure.values, figure.median())
    out["measured"] = ours
    out["source"] = figure.source
    out["met"] = target.met(ours["median"])
    for name, values, *middle in figure.peers:
        theirs = spread(values, *middle)
        ratio = ours["median"] / theirs["median"] if theirs["median"] else None
        out["peers"].append({"peer": name, "measured": theirs, "ratio": ratio})
    if target.id == "far" and out["peers"]:
        out["bound"] = "< peer's"
        out["met"] = ours["median"] < out["peers"][0]["measured"]["median"]
    if not out["peers"] and not target.alone:
        out["failed_peer"] = why or "the peer gave no figure"
    out["note"] = "; ".join(x for x in (figure.note, out["note"]) if x)
    return out


def rows(figures: dict, reasons: dict) -> list:
    return [row(t, figures.get(t.id), reasons.get(t.id)) for t in TARGETS]


VERDICTS = {True: "met", False: "**missed**", None: "-"}


def lines(r: dict) -> list:
    """Cells: target, unit, bound, measured, verdict, peer, its figure, ratio. Further peers below."""
    head = [r["target"], r["unit"], r["bound"]]
    if "failed" in r:
        return [[*head, r["failed"], "not measured", "-", "-", "-"]]
    mark = " *measured*" if r["source"] == "measured" else ""
    head += [in_words(r["measured"]) + mark, VERDICTS[r["met"]]]
    if not r["peers"]:
        return [[*head, r.get("failed_peer", "none"), "-", "-"]]
    found = []
    for p in r["peers"]:
        ratio = "-" if p["ratio"] is None else short(p["ratio"])
        found.append([*head, p["peer"], in_words(p["measured"]), ratio])
        head = ["″", "", "", "", ""]
    return found


def markdown(result: dict) -> str:
    m, v = result["machine"], result["versions"]
    out = ["# Targets and peers", "", INTRODUCTION, ""]
    if result["quick"]:
        out += ["**A quick run, only to see that everything works: too few repeats to be quoted.**", ""]
    if result["only"]:
        out += ["**Only some steps were run.**", ""]
    out += [
        f"{result['date']}, revision {result['revision']}{', with changes' if result['changed'] else ''}. "
        f"{m['cpu']}, {m['cpus']} cores, {m['memory_gib']:.0f} GiB; {m['system']}; load {m['load']:.1f} at the"
        f" start, {m['load_end']:.1f} at the end; the run took {result['minutes']:.0f} min.",
        "",
        ", ".join(f"{name} {number}" for name, number in v.items()) + ".",
    ]
    if m["load"] > 0.5:
        out += ["", "**Other work was running at the start: times are longer than they would be.**"]
    head = ["target", "unit", "bound", "measured", "verdict", "peer", "peer's figure", "ratio"]
    section, notes = None, []
    for r in result["rows"]:
        if r["section"] != section:
            section = r["section"]
            out += ["", f"## {section}", "", "| " + " | ".join(head) + " |"]
            out += ["|---|---|---:|---:|---|---|---:|---:|"]
        out += ["| " + " | ".join(cells) + " |" for cells in lines(r)]
        if r["note"]:
            notes.append(f"- {r['target']}: {r['note']}.")
    notes.append("- Lines with *none* for a peer and without a remark are about this program alone.")
    out += ["", "## Remarks", "", *notes, "", "## Measured elsewhere", "", "| what | with |", "|---|---|"]
    out += [f"| {what} | {f'`{command}`' if command else 'nothing yet'} |" for what, command in ELSEWHERE]
    return "\n".join(out) + "\n"


def summary(result: dict) -> str:
    met = [r["met"] for r in result["rows"]]
    absent = sum("failed" in r for r in result["rows"])
    text = f"{met.count(True)} bounds met, {met.count(False)} missed"
    return text + (f", {absent} targets not measured" if absent else "")
