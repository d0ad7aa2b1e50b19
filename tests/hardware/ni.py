"""A device behind nidaqmx's own interface to its driver: inputs clocked by an output."""

import time

import numpy as np
from nidaqmx._base_interpreter import BaseInterpreter
from nidaqmx.errors import DaqReadError

RATE, CONVERT, SETTLE = 0x1344, 0x1848, 0x1317
CHANNELS, AVAILABLE, INPUTS, WIDTH = 0x2181, 0x1223, 0x217B, 0x217E


def _missing(name):
    def method(self, *arguments):
        raise NotImplementedError(f"{name}{arguments}")

    return method


Base = type(
    "Base",
    (BaseInterpreter,),
    {name: _missing(name) for name in BaseInterpreter.__abstractmethods__},
)


class Device(Base):
    """Voltages under each ground, (M, M); `slowest` conversion it can do, s."""

    def __init__(self, volts, slowest=5e-7, overflow_after=None):
        self.volts, self.slowest = volts, slowest
        self.tasks, self.words, self.began = [], None, None
        self.numbers, self.taken, self.clock = {}, 0, ""
        self.overflow_after = overflow_after

    def create_task(self, name):
        self.tasks.append(f"task{len(self.tasks)}")
        return self.tasks[-1], True

    def clear_task(self, task):
        self.tasks.remove(task)
        self.began = None

    def create_do_chan(self, task, lines, name, grouping):
        assert lines == "Dev1/port0/line0:6" and grouping == 1
        self.output, self.lines = task, lines

    def create_ao_voltage_chan(self, task, lines, name, low, high, unit, scale):
        assert (lines, low, high) == ("Dev2/ao0:6", 0.0, 5.0)
        self.output, self.lines = task, lines

    def create_ai_voltage_chan(self, task, inputs, name, kind, low, high, unit, scale):
        assert inputs == "Dev1/ai0:63" and kind == 10083  # referenced, single-ended
        self.input = task

    def get_task_attribute_uint32(self, task, number):
        return {CHANNELS: 64}[number]

    def get_task_attribute_string(self, task, number):
        return ", ".join(f"Dev1/ai{k}" for k in range(64))

    def cfg_samp_clk_timing(self, task, rate, source, edge, mode, samples):
        assert samples >= 2 and mode == 10123  # continuous
        self.numbers[task, RATE] = rate
        if task == self.input:
            self.clock = source

    def set_timing_attribute_int32(self, task, number, value):
        assert value == 10364  # seconds

    def set_timing_attribute_double(self, task, number, value):
        if number == CONVERT:
            value = min(value, 1 / self.slowest)
        self.numbers[task, number] = value

    def get_timing_attribute_double(self, task, number):
        return self.numbers[task, number]

    def write_digital_u32(self, task, samples, auto_start, timeout, fill, words):
        self.words = np.array(words)
        return samples

    def write_analog_f64(self, task, samples, auto_start, timeout, fill, volts):
        self.words = (np.array(volts) > 2.5).T @ (1 << np.arange(7))
        return samples

    def get_write_attribute_uint32(self, task, number):
        return {WIDTH: 7 if "ao" in self.lines else 1}[number]

    def start_task(self, task):
        if task == self.input:
            self.taken = 0
        else:
            self.began = time.perf_counter()

    def stop_task(self, task):
        self.began = None

    def _there(self):
        if self.began is None:
            return 0
        rate = self.numbers[self.output, RATE]
        return int((time.perf_counter() - self.began) * rate) - self.taken

    def get_read_attribute_uint32(self, task, number):
        return {AVAILABLE: self._there(), INPUTS: 64}[number]

    def read_analog_f64(self, task, samples, timeout, fill, out):
        end = time.perf_counter() + timeout
        while self._there() < samples:
            if time.perf_counter() > end:
                raise DaqReadError("not yet there", -200284, 0)
            time.sleep(1e-4)
        if self.overflow_after is not None and self.taken > self.overflow_after:
            self.overflow_after = None
            raise DaqReadError("overwritten", -200279, 0)
        for k in range(samples):
            word = int(self.words[(self.taken + k) % len(self.words)])
            mux = {0b10: 0, 0b01: 1}[word >> 5]  # one of the two, enabled when low
            out[:, k] = self.volts[32 * mux + word % 32]
        self.taken += samples
        return out, samples
