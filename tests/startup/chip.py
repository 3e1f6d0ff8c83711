"""The STM32H743 around its core: what its registers do, as RM0433 says, with faults to choose.

Only what a register does by itself is here: ready bits that follow their switch, resets that end, protected registers, the
timers, the watchdog, one serial line, the Ethernet's DMA and a LAN8742A at its management interface. Everything else holds
what was written.
"""

import struct

from machine import NEVER
from registers import RESET

# Ready bits: what is written, the bit that asks, the register and bit that follow, and after how long, us.
READY = [
    ("CSI", "RCC.CR", 7, "RCC.CR", 8, 4.0),
    ("HSI48", "RCC.CR", 12, "RCC.CR", 13, 3.0),
    ("HSE", "RCC.CR", 16, "RCC.CR", 17, 2.0),
    ("PLL1", "RCC.CR", 24, "RCC.CR", 25, 150.0),
    ("COMPENSATION", "SYSCFG.CCCSR", 0, "SYSCFG.CCCSR", 8, 20.0),
    ("USB33", "PWR.CR3", 24, "PWR.CR3", 26, 10.0),
]
# Registers whose changes are ignored while a PLL runs.
PROTECTED = ["RCC.PLLCKSELR", "RCC.PLLCFGR", "RCC.PLL1DIVR"]
PLL_ON = 1 << 24 | 1 << 26 | 1 << 28
# Reset register and bit, and the peripheral that it resets.
RESETS = [
    ("RCC.AHB1RSTR", 15, "ETH"), ("RCC.AHB1RSTR", 27, "OTG_FS"), ("RCC.APB1LRSTR", 18, "USART3"),
    ("RCC.APB1LRSTR", 0, "TIM2"), ("RCC.APB2RSTR", 0, "TIM1"), ("RCC.APB1HRSTR", 1, "CRS"), ("RCC.APB4RSTR", 1, "SYSCFG"),
]
# What RCC_RSR says, RM0433 table "Reset source identification".
RESET_FLAGS = {"power-on": 0x00FE_0000, "software": 0x0142_0000, "watchdog": 0x0442_0000}
IRQ_TIM1_UP, IRQ_TIM1_CC, IRQ_USART3 = 25, 27, 39
OWN = 1 << 31
BYTE_US = 10.85
MDIO_US = 27.0


class Chip:
    """The registers. `options` is what the command line chose."""

    def __init__(self, options):
        self.options = options
        self.machine = None
        self.registers = {}
        # What happens whatever is reset: absolute time and action.
        self.plans = []
        self.events = []
        self.next_us = NEVER
        self.sent = bytearray()
        self.to_send = bytearray()

    # Reset and time.

    def reset(self, cause):
        flags = self.registers.get("RCC.RSR", 0)
        self.registers = dict(RESET)
        self.registers["RCC.RSR"] = RESET_FLAGS[cause] if cause == "power-on" else flags | RESET_FLAGS[cause]
        self.registers["DBGMCU.IDC"] = (0x1003 if self.options.revision == "Y" else 0x2003) << 16 | 0x450
        for name, register, bit in [("ACTVOS", "PWR.CSR1", 13), ("HSI", "RCC.CR", 2), ("AHBIDL", "OTG_FS.GRSTCTL", 31)]:
            if name in self.options.stuck:
                self.registers[register] &= ~(1 << bit)
        if "CSI" in self.options.stuck:
            self.registers["RCC.CR"] &= ~(1 << 8)
        self.events, self.next_us = [], min([NEVER] + [at for at, _ in self.plans])
        self.watchdog_at_us = NEVER
        self.systick_from_us, self.systick_seen = self.machine.now_us, 0
        self.timer_from_us = {}
        self.mdio_at_us = NEVER
        self.tx_next = 0
        self.flush_line()
        self.machine.say(f"reset {cause}")

    def at(self, us, do):
        """Does something later."""
        self.events.append((self.machine.now_us + us, do))
        self.next_us = min(self.next_us, self.machine.now_us + us)

    def advance(self):
        """Does all that is due."""
        now = self.machine.now_us
        due = [event for event in self.events + self.plans if event[0] <= now]
        self.events = [event for event in self.events if event[0] > now]
        self.plans = [event for event in self.plans if event[0] > now]
        for _, do in sorted(due, key=lambda event: event[0]):
            do()
        if self.watchdog_at_us <= now:
            self.watchdog_at_us = NEVER
            self.machine.fatal = "reset watchdog"
        self.next_us = min([self.watchdog_at_us] + [at for at, _ in self.events + self.plans])

    def feed(self):
        counts = self.registers["IWDG1.RLR"] + 1
        self.watchdog_at_us = self.machine.now_us + counts * 4 / 32_000 * 1e6
        self.next_us = min(self.next_us, self.watchdog_at_us)

    # Access.

    def read(self, name, at):
        self.advance()
        reader = getattr(self, "read_" + name.replace(".", "_"), None)
        if reader:
            return reader()
        if name.endswith(".IDR"):
            # D2 is wired to GND; everything else floats low.
            return 0
        return self.registers.get(name, 0)

    def write(self, name, at, value):
        before = self.registers.get(name, 0)
        peripheral, _, register = name.partition(".")
        if self.is_protected(name, value, before):
            self.machine.say(f"ignored {name}")
            return
        if peripheral == "NVIC":
            self.write_nvic(register, value)
            return
        writer = getattr(self, "write_" + name.replace(".", "_"), None)
        if writer:
            writer(value, before)
        else:
            self.registers[name] = value
        self.follow(name, before)
        if name.startswith("GPIO") and register == "BSRR":
            odr = f"{peripheral}.ODR"
            self.registers[odr] = (self.registers.get(odr, 0) | value & 0xFFFF) & ~(value >> 16)
        for reset, bit, resets in RESETS:
            if name == reset and value >> bit & 1:
                for other in [known for known in self.registers if known.startswith(resets + ".")]:
                    del self.registers[other]
                self.registers.update({known: held for known, held in RESET.items() if known.startswith(resets + ".")})

    def is_protected(self, name, value, before):
        """The PLLs' source and dividers while one runs (RM0433, RCC_PLLCKSELR)."""
        runs = self.registers["RCC.CR"] & PLL_ON
        return bool(runs) and name in PROTECTED and value != before

    def follow(self, name, before):
        for what, register, bit, ready, ready_bit, delay_us in READY:
            if name != register:
                continue
            on = self.registers[register] >> bit & 1
            # Ready bits cannot be written.
            kept = before & 1 << ready_bit
            self.registers[ready] = self.registers[ready] & ~(1 << ready_bit) | kept
            if not on:
                self.registers[ready] &= ~(1 << ready_bit)
            elif what not in self.options.stuck and not kept:
                self.become_ready(what, register, bit, ready, ready_bit, delay_us)

    def become_ready(self, what, register, bit, ready, ready_bit, delay_us):
        def do():
            if self.registers[register] >> bit & 1:
                self.registers[ready] |= 1 << ready_bit

        if what == "HSE":
            if self.options.hse_at_ms is None:
                return
            delay_us = max(delay_us, self.options.hse_at_ms * 1e3 - self.machine.now_us)
        self.at(delay_us, do)

    # Reset, clock and power control.

    def write_RCC_CR(self, value, before):
        self.registers["RCC.CR"] = value & ~(1 << 2) | before & 1 << 2
        clock_stops = self.options.hse_stops_ms
        if value & ~before & 1 << 19 and clock_stops is not None:
            self.at(max(0.0, clock_stops * 1e3 - self.machine.now_us), self.stop_hse)

    def stop_hse(self):
        self.registers["RCC.CIFR"] = self.registers.get("RCC.CIFR", 0) | 1 << 10
        self.registers["RCC.CR"] &= ~(1 << 17)
        self.registers["RCC.CFGR"] &= ~0x3F
        self.options.hse_at_ms = None
        self.machine.core_mhz = 64.0
        self.machine.nmi = True

    def write_RCC_CFGR(self, value, _before):
        switched = value & 7
        ready = self.registers["RCC.CR"] >> 25 & 1 if switched == 3 else switched == 0
        if "SWS" in self.options.stuck:
            ready = False
        status = switched if ready else self.registers.get("RCC.CFGR", 0) >> 3 & 7
        self.registers["RCC.CFGR"] = value & ~0x38 | status << 3
        self.machine.core_mhz = 480.0 if status == 3 else 64.0

    def write_RCC_RSR(self, value, before):
        self.registers["RCC.RSR"] = 0 if value & 1 << 16 else before

    def write_RCC_CICR(self, value, _before):
        self.registers["RCC.CIFR"] = self.registers.get("RCC.CIFR", 0) & ~value

    def write_RCC_AHB2ENR(self, value, _before):
        self.registers["RCC.AHB2ENR"] = value
        self.machine.map_clocked(value)

    def write_PWR_D3CR(self, value, _before):
        self.registers["PWR.D3CR"] = value & 0xC000
        self.voltage_changes()

    def write_SYSCFG_PWRCR(self, value, _before):
        self.registers["SYSCFG.PWRCR"] = value
        self.registers["PWR.D3CR"] &= ~(1 << 13)
        self.voltage_changes()

    def voltage_changes(self):
        if "VOS" in self.options.stuck:
            return
        if "OVERDRIVE" in self.options.stuck and self.registers.get("SYSCFG.PWRCR", 0) & 1:
            return

        def do():
            self.registers["PWR.D3CR"] |= 1 << 13

        self.at(30.0, do)

    def write_FLASH_ACR(self, value, before):
        self.registers["FLASH.ACR"] = before if "LATENCY" in self.options.stuck else value & 0x3F

    def write_IWDG1_KR(self, value, _before):
        if value in (0xCCCC, 0xAAAA):
            if value == 0xCCCC or self.watchdog_at_us != NEVER:
                self.feed()
        self.registers["IWDG1.unlocked"] = value == 0x5555

    def write_IWDG1_RLR(self, value, before):
        self.registers["IWDG1.RLR"] = value & 0xFFF if self.registers.get("IWDG1.unlocked") else before

    # The core's peripherals.

    def read_SYST_CSR(self):
        period_us = (self.registers.get("SYST.RVR", 0) + 1) / self.machine.core_mhz
        passed = int((self.machine.now_us - self.systick_from_us) / period_us)
        wrapped, self.systick_seen = passed > self.systick_seen, passed
        return self.registers.get("SYST.CSR", 0) & ~(1 << 16) | int(wrapped) << 16

    def write_SYST_CVR(self, _value, _before):
        self.systick_from_us, self.systick_seen = self.machine.now_us, 0

    def write_SCB_AIRCR(self, value, before):
        if value & 0xFFFF_0004 == 0x05FA_0004:
            self.machine.fatal = "reset software"
        self.registers["SCB.AIRCR"] = 0xFA05_0000 | value & 0x700

    def write_nvic(self, register, value):
        bank = int(register.lstrip("IABCEPRS") or 0)
        numbers = {32 * bank + bit for bit in range(32) if value >> bit & 1}
        if register.startswith("ISER"):
            self.machine.enabled |= numbers
        elif register.startswith("ICER"):
            self.machine.enabled -= numbers
        elif register.startswith("ISPR"):
            self.machine.pending |= numbers
        elif register.startswith("ICPR"):
            self.machine.pending -= numbers
        else:
            self.registers[f"NVIC.{register}"] = value
        for bank in range(5):
            mask = sum(1 << number % 32 for number in self.machine.enabled if number // 32 == bank)
            self.registers[f"NVIC.ISER{bank}"] = mask

    def interrupt_priority(self, number):
        return self.registers.get(f"NVIC.IPR{number // 4}", 0) >> 8 * (number % 4) & 0xFF

    # Timers: TIM1 releases, TIM2 counts.

    def timer_hz(self):
        return self.machine.core_mhz * 1e6 / 2

    def timer_count(self, timer):
        if timer not in self.timer_from_us:
            return self.registers.get(f"{timer}.CNT", 0)
        ticks = (self.machine.now_us - self.timer_from_us[timer]) * self.timer_hz() / 1e6
        return int(ticks / (self.registers.get(f"{timer}.PSC", 0) + 1))

    def read_TIM2_CNT(self):
        return self.timer_count("TIM2") & 0xFFFF_FFFF

    def read_TIM1_CNT(self):
        return self.timer_count("TIM1") & 0xFFFF

    def write_TIM2_CR1(self, value, before):
        self.registers["TIM2.CR1"] = value
        if value & ~before & 1:
            self.timer_from_us["TIM2"] = self.machine.now_us

    def write_TIM1_EGR(self, _value, _before):
        self.registers["TIM1.CNT"] = 0

    def write_TIM1_CR1(self, value, before):
        self.registers["TIM1.CR1"] = value
        if value & ~before & 1:
            self.start_period(self.registers.get("TIM1.CNT", 0))

    def write_TIM1_SR(self, value, before):
        self.registers["TIM1.SR"] = before & value

    def start_period(self, count):
        """TIM1 counts on from `count`."""
        tick_us = (self.registers.get("TIM1.PSC", 0) + 1) / self.timer_hz() * 1e6
        self.timer_from_us["TIM1"] = self.machine.now_us - count * tick_us
        end, compare = self.registers["TIM1.ARR"] + 1, self.registers.get("TIM1.CCR1", 0)
        if compare > count:
            self.at((compare - count) * tick_us, lambda: self.flag_timer(1, IRQ_TIM1_CC))

        def wrap():
            self.flag_timer(0, IRQ_TIM1_UP)
            self.start_period(0)

        self.at((end - count) * tick_us, wrap)

    def flag_timer(self, bit, interrupt):
        self.registers["TIM1.SR"] = self.registers.get("TIM1.SR", 0) | 1 << bit
        if self.registers.get("TIM1.DIER", 0) >> bit & 1:
            self.machine.pending.add(interrupt)

    # The serial line.

    def read_USART3_ISR(self):
        status = 0xC0 if "TXE" not in self.options.stuck else 0
        return status | (1 << 5 if self.to_send else 0)

    def read_USART3_RDR(self):
        return self.to_send.pop(0) if self.to_send else 0

    def write_USART3_TDR(self, value, _before):
        self.sent.append(value & 0xFF)
        self.machine.now_us += BYTE_US if self.machine.reads_since_write > 64 else 0
        if value & 0xFF in (0x00, 0x0A):
            self.flush_line()

    def write_USART3_CR3(self, value, _before):
        self.registers["USART3.CR3"] = value
        if value >> 23 & 1:
            self.at(16 * BYTE_US, lambda: self.machine.pending.add(IRQ_USART3))

    def flush_line(self):
        if self.sent:
            self.machine.say(f"serial {self.sent.hex()}")
            self.sent.clear()

    def host_says(self, data):
        self.to_send += data
        self.machine.pending.add(IRQ_USART3)

    # The USB's controller: resets and flushes end at once.

    def write_OTG_FS_GRSTCTL(self, value, before):
        stuck = sum(1 << bit for name, bit in [("CSRST", 0), ("RXFFLSH", 4), ("TXFFLSH", 5)] if name in self.options.stuck)
        self.registers["OTG_FS.GRSTCTL"] = before & 1 << 31 | value & 0x7C0 | value & stuck

    def write_OTG_FS_GINTSTS(self, value, before):
        self.registers["OTG_FS.GINTSTS"] = before & ~(value & 0xF030_FFF8)

    # Ethernet: management interface, DMA.

    def write_ETH_MACMDIOAR(self, value, _before):
        self.registers["ETH.MACMDIOAR"] = value
        if value & 1 and "MDIO" not in self.options.stuck:
            self.at(MDIO_US, self.end_management)

    def end_management(self):
        access = self.registers["ETH.MACMDIOAR"]
        phy, register, is_read = access >> 21 & 31, access >> 16 & 31, access >> 2 & 3 == 3
        if is_read:
            self.registers["ETH.MACMDIODR"] = self.phy(register) if phy == 0 and self.options.phy else 0xFFFF
        else:
            self.machine.say(f"phy {phy} register {register} = {self.registers.get('ETH.MACMDIODR', 0):#06x}")
        self.registers["ETH.MACMDIOAR"] = access & ~1

    def phy(self, register):
        """A LAN8742A with a link (its data sheet, register map)."""
        return {0: 0x3000, 1: 0x782D, 2: 0x0007, 3: 0xC131, 4: 0x01E1, 5: 0x4101, 18: 0x60E0}.get(register, 0)

    def write_ETH_DMAMR(self, value, _before):
        # The reset ends only with the PHY's reference clock.
        self.registers["ETH.DMAMR"] = value
        if value & 1 and self.options.phy:
            self.at(20.0, self.end_ethernet_reset)

    def end_ethernet_reset(self):
        for name in [known for known in self.registers if known.startswith("ETH.")]:
            del self.registers[name]
        self.registers.update({known: held for known, held in RESET.items() if known.startswith("ETH.")})
        self.tx_next = 0

    def write_ETH_DMACSR(self, value, before):
        self.registers["ETH.DMACSR"] = before & ~value

    def write_ETH_DMACTXDTPR(self, value, _before):
        self.registers["ETH.DMACTXDTPR"] = value
        runs = self.registers.get("ETH.DMACTXCR", 0) & 1 and self.registers["ETH.MACCR"] & 2
        while runs and self.send_frame():
            pass

    def send_frame(self):
        """Sends the frame of the descriptor in turn, if the DMA owns it."""
        start, last = self.registers["ETH.DMACTXDLAR"], self.registers.get("ETH.DMACTXRLR", 0)
        descriptor = start + 16 * self.tx_next
        if descriptor == self.registers["ETH.DMACTXDTPR"]:
            return False
        buffer, _, lengths, status = struct.unpack("<4I", self.machine.uc.mem_read(descriptor, 16))
        if not status & OWN:
            return False
        frame = bytes(self.machine.uc.mem_read(buffer, lengths & 0x3FFF))
        self.machine.say(f"frame {frame.hex()}")
        self.machine.uc.mem_write(descriptor + 12, struct.pack("<I", status & ~OWN))
        self.tx_next = 0 if self.tx_next == last else self.tx_next + 1
        return True

