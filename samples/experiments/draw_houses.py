"""Draw the test houses of an experiment from HouseExpo's test list, by a fixed seed.

    python samples/experiments/draw_houses.py HOUSES.tar.gz map_id_test.txt > d2-test.txt
    python samples/experiments/draw_houses.py HOUSES.tar.gz map_id_test.txt 200 > sealed-test.txt

The ids are sorted, shuffled with the seed, and the first hundred (or as many as are asked for)
that can be rasterized are taken: what is drawn depends on the list alone, and on which of its
houses the archive has. So a longer list begins with a shorter one.
"""

import sys
from pathlib import Path

from mapreplay.errors import FloorPlanError
from mapreplay.floorplans import open_source, read_ids, select
from mapreplay.randomness import Draws, Purpose

SEED = 2022
HOUSES = int(sys.argv[3]) if len(sys.argv) > 3 else 100

source = open_source(sys.argv[1])
there = sorted(select(source, read_ids(Path(sys.argv[2]))).ids)
shuffled = [there[i] for i in Draws(SEED, Purpose.SHUFFLE).permutation(len(there)).tolist()]
drawn: list[str] = []
for house in shuffled:
    try:
        source.load(house)
    except FloorPlanError as error:
        print(f"passed over: {error}", file=sys.stderr)
        continue
    drawn.append(house)
    if len(drawn) == HOUSES:
        break
print(f"# {HOUSES} houses of {Path(sys.argv[2]).name}, drawn with seed {SEED} by draw_houses.py")
print(*drawn, sep="\n")
