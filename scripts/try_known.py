"""One knob of the analysis on one volume of known truth, every setting in a process of its own."""

import pandas as pd
from _stage import stage

from grainfall import io, random
from grainfall.accuracy import known

with stage(snakemake) as progress:
    knob, repeat = snakemake.wildcards.knob, int(snakemake.wildcards.repeat)
    rng = random.generator(snakemake.params.seed, knob, repeat, "accuracy")
    known.warm_up()
    rows = []
    for trial in known.KNOBS[knob](snakemake.params.settings, rng, known.alone):
        about = {
            "scene": knob,
            "knob": knob,
            "setting": trial.setting,
            "against": trial.against,
            "repeat": repeat,
        }
        rows += [
            {**about, "metric": metric, "difference": difference, **trial.cost._asdict()}
            for metric, difference in trial.differences.items()
        ]
        progress.say(f"{trial.setting}: {trial.cost.cpu_s:.3g} CPU s")
    io.write_table(snakemake.output[0], pd.DataFrame(rows))
