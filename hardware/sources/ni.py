"""National Instruments' converters by nidaqmx, with multiplexers that ground electrodes.

The source has not run on hardware yet. It is tested against nidaqmx's own interface to its
driver.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from tomojax._require import require, require_library
from tomojax.hardware.sources._frames import check_grounds
from tomojax.hardware.sources._source import Counters, Got, SlotSource

_WAYS = 32  # inputs of a multiplexer (ADG732)
_HIGH = 5.0  # V of a line that is on
_BLOCK = 64  # slots that are read at once where they wait
_KEPT = 100_000  # slots that the driver keeps
_CLOSE = 0.01  # what a device may differ by from what it was asked for

_TIMEOUT = -200284  # the driver's number for: not yet there


def word_of(ground: int) -> int:
    """Returns a ground's bits for two ADG732: 0 to 4 address, 5 and 6 off when high."""
    mux, address = divmod(ground, _WAYS)
    return address | (0b01 if mux else 0b10) << 5


class NiSource(SlotSource):
    """A PXIe-6355 or its like: reads `inputs` under each ground that `lines` set.

    Every tick of the output's sample clock puts a ground's address on the lines. The inputs
    are converted one after another, `convert` (s) apart, after a settling delay `settle`
    (s). One clock drives lines and inputs, so that the k-th slot has the k-th ground.
    `lines` are digital ("Dev1/port0/line0:6") or analog ("Dev2/ao0:6", 5 V), see `word_of`.

    To set other grounds, the source stops and starts again. That takes milliseconds, which
    count as lost slots. Use this source for patterns, not for a closed loop.
    **Raises:** `ValueError` if a slot has no room for `settle` and all conversions, or (at
    `start`) if the device cannot do what is asked; `OSError` without the driver.
    """

    def __init__(
        self,
        inputs: str = "Dev1/ai0:63",
        lines: str = "Dev1/port0/line0:6",
        rate: float = 10e3,
        settle: float = 20e-6,
        convert: float = 1e-6,
        full_scale: float = 5.0,
        electrodes: int = 64,
    ):
        need = settle + electrodes * convert
        told = f"{settle:g} s and {electrodes} conversions of {convert:g} s: {need:.3g} s"
        require(
            0 < need <= 1 / rate, "settle", told, f"no more than a slot, {1 / rate:g} s"
        )
        require(electrodes <= 2 * _WAYS, "electrodes", electrodes, f"{2 * _WAYS} at most")
        self.electrodes, self.rate = electrodes, rate
        self.scale, self.offset = 1.05 * full_scale / 32767, 0.0
        self.counters = Counters()
        self._names = inputs, lines
        self._times, self._full_scale = (settle, convert), full_scale
        self._grounds: tuple[int, ...] = (0,)
        self._tasks: tuple[Any, Any] | None = None

    def start(self) -> None:
        require_library("nidaqmx", "ni")
        import nidaqmx
        import nidaqmx.constants
        import nidaqmx.errors
        import nidaqmx.stream_readers
        import nidaqmx.stream_writers

        self._daq: Any = nidaqmx
        try:
            output, self._input = nidaqmx.Task(), nidaqmx.Task()
        except (self._daq.errors.DaqNotFoundError, self._daq.errors.DaqNotSupportedError):
            raise OSError("the NI-DAQmx driver is not installed; ni.com has it") from None
        self._tasks = output, self._input
        try:
            self._configure(output)
        except self._daq.errors.DaqError as error:
            self.stop()
            reason = str(error).partition("\n")[0]
            raise ValueError(f"source: {self._names[0]}: {reason}") from None
        except ValueError:
            self.stop()
            raise
        self._reader = self._daq.stream_readers.AnalogMultiChannelReader(
            self._input.in_stream
        )
        self._room = {n: np.zeros((self.electrodes, n)) for n in (1, _BLOCK)}
        self._number = 0
        self._begun: float | None = None
        self._last = 0.0
        self._go()

    def _configure(self, output: Any) -> None:
        constants = self._daq.constants
        inputs, lines = self._names
        if "/ao" in lines:
            output.ao_channels.add_ao_voltage_chan(lines, min_val=0.0, max_val=_HIGH)
            clock = "ao"
        else:
            grouping = constants.LineGrouping.CHAN_FOR_ALL_LINES
            output.do_channels.add_do_chan(lines, line_grouping=grouping)
            clock = "do"
        top = self._full_scale
        referenced = constants.TerminalConfiguration.RSE
        self._input.ai_channels.add_ai_voltage_chan(
            inputs, terminal_config=referenced, min_val=-top, max_val=top
        )
        number = self._input.number_of_channels
        require(number == self.electrodes, "inputs", number, f"{self.electrodes}")
        device = lines.strip("/").partition("/")[0]
        timing, forever = self._input.timing, constants.AcquisitionType.CONTINUOUS
        source = f"/{device}/{clock}/SampleClock"
        timing.cfg_samp_clk_timing(
            self.rate, source, sample_mode=forever, samps_per_chan=_KEPT
        )
        settle, convert = self._times
        timing.delay_from_samp_clk_delay_units = constants.DigitalWidthUnits.SECONDS
        timing.delay_from_samp_clk_delay = settle
        timing.ai_conv_rate = 1 / convert
        self._check("settle", timing.delay_from_samp_clk_delay, settle)
        self._check("convert", 1 / timing.ai_conv_rate, convert)

    def _check(self, name: str, got: float, asked: float) -> None:
        near = abs(got - asked) <= _CLOSE * asked
        require(near, name, f"{asked:g}", f"what the device can do, here {got:.4g}")

    def _go(self) -> None:
        """Starts the grounds at the first one; the input starts before the output."""
        assert self._tasks is not None
        output = self._tasks[0]
        # A buffer of one sample there is not.
        writers = self._daq.stream_writers
        words = [word_of(g) for g in self._grounds * (2 if len(self._grounds) == 1 else 1)]
        forever = self._daq.constants.AcquisitionType.CONTINUOUS
        output.timing.cfg_samp_clk_timing(
            self.rate, sample_mode=forever, samps_per_chan=len(words)
        )
        self._check("rate", output.timing.samp_clk_rate, self.rate)
        if "/ao" in self._names[1]:
            bits = np.array(words) >> np.arange(7)[:, None] & 1
            analog = writers.AnalogMultiChannelWriter(output.out_stream, auto_start=False)
            analog.write_many_sample(_HIGH * bits.astype(float))
        else:
            port = writers.DigitalSingleChannelWriter(output.out_stream, auto_start=False)
            port.write_many_sample_port_uint32(np.array(words, np.uint32))
        self._turn, self._waits, self._block = 0, 0, self._room[1]
        self._input.start()
        output.start()

    def read(self, codes: Int[np.ndarray, " M"], timeout: float = 1.0) -> Got | None:
        if not self._waits and not self._fetch(timeout):
            return None
        at = self._block.shape[1] - self._waits
        self._waits -= 1
        exact = np.rint(self._block[:, at] / self.scale)
        codes[:] = np.clip(exact, -32768, 32767)
        ground = self._grounds[self._turn % len(self._grounds)]
        self._turn += 1
        lost = self._lost()
        when = (self._number + lost) / self.rate
        return self._counted(ground, lost, when, self._last)

    def _lost(self) -> int:
        """Returns how many slots a stop has cost."""
        if self._begun is None:
            return 0
        away, self._begun = self._last - self._begun, None
        return max(0, round(away * self.rate) - 1)

    def _fetch(self, timeout: float) -> bool:
        there = self._input.in_stream.avail_samp_per_chan
        count = _BLOCK if there >= _BLOCK else 1
        block = self._room[count]
        try:
            self._reader.read_many_sample(block, count, timeout)
        except self._daq.errors.DaqReadError as error:
            if error.error_code == _TIMEOUT:
                return False
            # It kept more than it has room for: the oldest are gone.
            self.counters.disconnects += 1
            self._halt()
            self._go()
            return False
        self._block, self._waits, self._last = block, count, time.perf_counter()
        return True

    def _halt(self) -> None:
        assert self._tasks is not None
        if self._begun is None and self._last:
            self._begun = self._last
        for task in self._tasks:
            task.stop()

    def set_grounds(self, grounds: Sequence[int]) -> None:
        self._grounds = check_grounds(grounds, self.electrodes)
        if self._tasks is not None:
            self._halt()
            self._go()

    def stop(self) -> None:
        for task in self._tasks or ():
            task.close()
        self._tasks = None

    @property
    def waiting(self) -> int:
        return self._waits
