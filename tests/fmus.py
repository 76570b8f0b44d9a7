"""FMUs run by fmpy, which knows nothing of the exporter."""

import contextlib
import shutil
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu


class Fmu:
    """An unpacked FMU: its description, and instances of it."""

    def __init__(self, file):
        self.file, self.folder = file, extract(file)
        self.description = read_model_description(self.folder)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.old = self.description.fmiVersion == "2.0"
        self.instances = []

    def close(self):
        for one in self.instances:
            one.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)

    def named(self, causality):
        return [v.name for v in self.description.modelVariables if v.causality == causality]

    def instance(self):
        self.instances.append(Instance(self))
        return self.instances[-1]


@contextlib.contextmanager
def opened(content, folder):
    """Open an FMU from its bytes."""
    file = Path(folder, "x.fmu")
    file.write_bytes(content)
    fmu = Fmu(str(file))
    try:
        yield fmu
    finally:
        fmu.close()


class Instance:
    """One instance; `said` are its messages."""

    def __init__(self, of):
        self.of, self.said, self.time = of, [], 0.0
        if of.old:
            log = lambda environment, name, status, category, message: self.said.append(message.decode())  # noqa: E731
        else:
            log = lambda environment, status, category, message: self.said.append(message.decode())  # noqa: E731
        self.fmu = instantiate_fmu(of.folder, of.description, "CoSimulation", logger=log)

    def set(self, **values):
        references, numbers = [self.of.references[n] for n in values], list(map(float, values.values()))
        (self.fmu.setReal if self.of.old else self.fmu.setFloat64)(references, numbers)

    def get(self, name):
        return (self.fmu.getReal if self.of.old else self.fmu.getFloat64)([self.of.references[name]])[0]

    def begin(self, start=0.0, **values):
        self.time = start
        if self.of.old:
            self.fmu.setupExperiment(startTime=start)
            self.set(**values)
            self.fmu.enterInitializationMode()
        else:
            self.set(**values)
            self.fmu.enterInitializationMode(startTime=start)
        self.fmu.exitInitializationMode()

    def step(self, length):
        self.fmu.doStep(self.time, length)
        self.time += length

    def run(self, Ts, **waves):
        """What an ordinary master reads: the output at the start, and after each step, one more than the inputs."""
        (output,) = self.of.named("output")
        found = [self.get(output)]
        for i in range(len(next(iter(waves.values())))):
            self.set(**{n: x[i] for n, x in waves.items()})
            self.step(Ts)
            found.append(self.get(output))
        return np.array(found)

    def reset(self):
        self.fmu.reset()
