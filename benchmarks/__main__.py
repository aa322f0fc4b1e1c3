"""``python -m benchmarks [NAME ...]``: run all benchmarks of this folder, or the named ones, and print the
results."""

from __future__ import annotations

import argparse
import sys

from . import flames, house, page


def options(names: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("name", nargs="*", help=f"of: {', '.join(names)}")
    parser.add_argument("--rounds", type=int, help="how often every side runs (default: what the question says)")
    parser.add_argument("--short", action="store_true", help="seconds instead of minutes; rough figures")
    parser.add_argument("--seed", type=int, default=0, help="of the order in which the sides run")
    parser.add_argument("--write", action="store_true", help="keep the result, draw it, make docs/benchmarks.md")
    parser.add_argument("--flames", action="store_true", help="look where our side computes; kept as with --write")
    parser.add_argument("--page", action="store_true", help="run nothing; make plots and page from what is kept")
    return parser.parse_args()


def say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main() -> int:
    questions = house.questions()
    chosen = options(list(questions))
    unknown = [name for name in chosen.name if name not in questions]
    if unknown:
        say(f"no question is called {', '.join(unknown)}; there are: {', '.join(questions)}")
        return 2
    names = chosen.name or list(questions)
    if chosen.page:
        for name in names:
            kept = house.RESULTS / f"{name}.json"
            if kept.exists():
                page.plot(questions[name], house.Result.read(kept), page.PLOTS / f"{name}.svg")
        say(f"wrote {page.write(questions)}")
        return 0
    failed = []
    for name in names:
        question = questions[name]
        rounds = chosen.rounds or (1 if chosen.short else question.rounds)
        try:
            if chosen.flames:
                say(f"wrote {flames.record(question, chosen.short)}")
                continue
            result = house.run(question, rounds, chosen.short, chosen.seed, say)
        except Exception as error:  # a failed question must not prevent the other questions
            say(f"{name} failed: {type(error).__name__}: {error}")
            failed.append(name)
            continue
        print(page.section(question, result), flush=True)
        if chosen.write:
            say(f"wrote {result.write()}")
            page.plot(question, result, page.PLOTS / f"{name}.svg")
    if chosen.write or chosen.flames:
        say(f"wrote {page.write(questions)}")
    if failed:
        say(f"failed: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
