"""Truths and answers of sealed boxes, made up for the tests."""

from benchmarks.search.sealed import boxes
from benchmarks.search.sealed.fisher import FREE

TINY = {"clips": 8, "frames": 60, "noises": {"white": 1}, "ratios": (20,)}


def truth_of(hidden, clips=2, **more):
    names = list(dict.fromkeys(k.partition(".")[0] for k in hidden))
    plain = {"study": "test", "box": 0, "kind": "one", "seed": 5, "noise": "white", "claimed": 1.0, "clips": clips}
    plain |= {
        "frames": 90,
        "exchanged": True,
        "defect": {},
        "size": [640, 480],
        "source": "synthcam",
        "effects": names,
        "hidden": hidden,
    }
    return plain | {"base": {k: getattr(boxes.Model(), k) for k in FREE}} | more


def line(effects, named, aliases=(), verdict="named", **more):
    truth = truth_of({f"{e}.share": 1.0 for e in effects}) | {"kind": "two" if len(effects) > 1 else "one"} | more
    truth |= {"about": [{"ratio": 6.0, "nearest": 0.5} for _ in effects]}
    entries = [{"effect": n, "parameters": {f"{n}.share": 1.3}, "std": {f"{n}.share": 0.1}} for n in named]
    return {"truth": truth, "answer": {"verdict": verdict, "named": entries, "aliases": list(aliases)}}
