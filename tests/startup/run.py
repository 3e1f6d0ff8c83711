"""Runs a firmware image of the NUCLEO-H743ZI2 from its reset vector on a model of its chip, and prints what it did.

Prints one event a line: `reset`, `write`, `read` (of what was read since the last write the last value), `ignored` (a
write that the chip does not take), `serial`, `phy` and `frame` in hexadecimal, `wfi`; then `final`, each register that is
not as after a reset; then `end` with the reason and the virtual time. The rules that all this has to keep are in
tests/start_up.rs, which runs this program.
"""

import argparse
import sys

from chip import Chip
from machine import CLOCKED_RAMS, Machine
from registers import RESET


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("image", help="ELF file of the firmware")
    options.add_argument("--seed", type=int, default=1, help="what the memories hold at power-on")
    options.add_argument("--revision", choices=["V", "Y"], default="V", help="silicon revision")
    options.add_argument("--hse-at-ms", type=float, default=0.0, help="when the 8 MHz come")
    options.add_argument("--hse-absent", dest="hse_at_ms", action="store_const", const=None, help="the 8 MHz never come")
    options.add_argument("--hse-stops-ms", type=float, help="when the 8 MHz stop")
    options.add_argument("--no-phy", dest="phy", action="store_false", help="no PHY answers, no reference clock runs")
    options.add_argument("--stuck", action="append", default=[], help="a ready bit that never comes; several times")
    options.add_argument("--until-ms", type=float, help="end of the run in virtual time; without it, the first WFI")
    options.add_argument("--limit-ms", type=float, default=20_000.0, help="virtual time after which no WFI counts as never")
    options.add_argument("--host", type=bytes.fromhex, default=b"", help="what a host says on the serial line, in hexadecimal")
    options.add_argument("--host-at-ms", type=float, default=40.0, help="when it says it")
    options.add_argument("--full-log", type=lambda text: int(text, 0), help="address of the log's control block: from 20 ms on "
                         "the log is full, and a debug probe that has gone has asked for waiting writes")
    chosen = options.parse_args()
    chip = Chip(chosen)
    if chosen.host:
        chip.plans.append((chosen.host_at_ms * 1e3, lambda: chip.host_says(chosen.host)))
    if chosen.full_log:
        chip.plans.append((20e3, lambda: machine.fill_log(chosen.full_log)))
    machine = Machine(chosen.image, chip, chosen.seed)
    reason = machine.run((chosen.until_ms or chosen.limit_ms) * 1e3, chosen.until_ms is None)
    chip.flush_line()
    for bit, start, size in CLOCKED_RAMS:
        if start in machine.mapped:
            not_zero = size - bytes(machine.uc.mem_read(start, size)).count(0)
            machine.say(f"final SRAM{bit - 28}.not_zero {not_zero:#010x}")
    for name, value in sorted(chip.registers.items()):
        if "." in name and value != RESET.get(name, 0):
            machine.say(f"final {name} {value:#010x}")
    machine.say(f"end {reason} {machine.now_us / 1e3:.3f} ms")
    sys.stdout.write("\n".join(machine.lines) + "\n")


main()
