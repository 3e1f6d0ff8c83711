"""The STM32H743's registers: where they are, what they are called, and what they hold after a reset.

Facts of RM0433 (memory map, register maps) and of the ARMv7-M manual; nothing here is taken from the firmware. A register
that is not named has its peripheral's name and its offset, and is zero after a reset.
"""

# Peripheral: base address and register names by offset.
_RCC = {
    0x00: "CR", 0x04: "HSICFGR", 0x08: "CRRCR", 0x10: "CFGR", 0x18: "D1CFGR", 0x1C: "D2CFGR", 0x20: "D3CFGR",
    0x28: "PLLCKSELR", 0x2C: "PLLCFGR", 0x30: "PLL1DIVR", 0x34: "PLL1FRACR", 0x38: "PLL2DIVR", 0x40: "PLL3DIVR",
    0x4C: "D1CCIPR", 0x50: "D2CCIP1R", 0x54: "D2CCIP2R", 0x58: "D3CCIPR", 0x60: "CIER", 0x64: "CIFR", 0x68: "CICR",
    0x70: "BDCR", 0x74: "CSR", 0x7C: "AHB3RSTR", 0x80: "AHB1RSTR", 0x84: "AHB2RSTR", 0x88: "AHB4RSTR",
    0x8C: "APB3RSTR", 0x90: "APB1LRSTR", 0x94: "APB1HRSTR", 0x98: "APB2RSTR", 0x9C: "APB4RSTR", 0xD0: "RSR",
    0xD4: "AHB3ENR", 0xD8: "AHB1ENR", 0xDC: "AHB2ENR", 0xE0: "AHB4ENR", 0xE4: "APB3ENR", 0xE8: "APB1LENR",
    0xEC: "APB1HENR", 0xF0: "APB2ENR", 0xF4: "APB4ENR", 0xFC: "AHB3LPENR", 0x100: "AHB1LPENR", 0x104: "AHB2LPENR",
}
_GPIO = {
    0x00: "MODER", 0x04: "OTYPER", 0x08: "OSPEEDR", 0x0C: "PUPDR", 0x10: "IDR", 0x14: "ODR", 0x18: "BSRR",
    0x1C: "LCKR", 0x20: "AFRL", 0x24: "AFRH",
}
_TIM = {
    0x00: "CR1", 0x04: "CR2", 0x08: "SMCR", 0x0C: "DIER", 0x10: "SR", 0x14: "EGR", 0x18: "CCMR1", 0x20: "CCER",
    0x24: "CNT", 0x28: "PSC", 0x2C: "ARR", 0x34: "CCR1",
}
_USART = {
    0x00: "CR1", 0x04: "CR2", 0x08: "CR3", 0x0C: "BRR", 0x18: "RQR", 0x1C: "ISR", 0x20: "ICR", 0x24: "RDR",
    0x28: "TDR", 0x2C: "PRESC",
}
_ETH = {
    0x00: "MACCR", 0x04: "MACECR", 0x08: "MACPFR", 0x200: "MACMDIOAR", 0x204: "MACMDIODR", 0x300: "MACA0HR",
    0x304: "MACA0LR", 0x308: "MACA1HR", 0x30C: "MACA1LR", 0x700: "MMC_CONTROL", 0x70C: "MMC_RX_INT_MASK",
    0x710: "MMC_TX_INT_MASK", 0xC00: "MTLOMR", 0xD00: "MTLTXQOMR", 0xD30: "MTLRXQOMR", 0x1000: "DMAMR",
    0x1004: "DMASBMR", 0x1100: "DMACCR", 0x1104: "DMACTXCR", 0x1108: "DMACRXCR", 0x1114: "DMACTXDLAR",
    0x111C: "DMACRXDLAR", 0x1120: "DMACTXDTPR", 0x1128: "DMACRXDTPR", 0x112C: "DMACTXRLR", 0x1130: "DMACRXRLR",
    0x1134: "DMACIER", 0x1160: "DMACSR",
}
_OTG = {
    0x00: "GOTGCTL", 0x04: "GOTGINT", 0x08: "GAHBCFG", 0x0C: "GUSBCFG", 0x10: "GRSTCTL", 0x14: "GINTSTS",
    0x18: "GINTMSK", 0x1C: "GRXSTSR", 0x20: "GRXSTSP", 0x24: "GRXFSIZ", 0x28: "DIEPTXF0", 0x38: "GCCFG", 0x3C: "CID",
    0x800: "DCFG", 0x804: "DCTL", 0x808: "DSTS", 0x810: "DIEPMSK", 0x814: "DOEPMSK", 0x818: "DAINT", 0x81C: "DAINTMSK",
    0xE00: "PCGCCTL",
}
for _n in range(1, 9):
    _OTG[0x100 + 4 * _n] = f"DIEPTXF{_n}"
for _n in range(9):
    _OTG.update({0x900 + 0x20 * _n: f"DIEPCTL{_n}", 0x908 + 0x20 * _n: f"DIEPINT{_n}", 0x910 + 0x20 * _n: f"DIEPTSIZ{_n}"})
    _OTG.update({0xB00 + 0x20 * _n: f"DOEPCTL{_n}", 0xB08 + 0x20 * _n: f"DOEPINT{_n}", 0xB10 + 0x20 * _n: f"DOEPTSIZ{_n}"})

_PERIPHERALS = [
    ("TIM2", 0x4000_0000, 0x400, _TIM),
    ("USART3", 0x4000_4800, 0x400, _USART),
    ("CRS", 0x4000_8400, 0x400, {0: "CR", 4: "CFGR", 8: "ISR", 0xC: "ICR"}),
    ("TIM1", 0x4001_0000, 0x400, _TIM),
    ("ETH", 0x4002_8000, 0x1400, _ETH),
    ("OTG_FS", 0x4008_0000, 0x4_0000, _OTG),
    ("FLASH", 0x5200_2000, 0x1000, {0: "ACR"}),
    ("SYSCFG", 0x5800_0400, 0x400, {4: "PMCR", 0x20: "CCCSR", 0x24: "CCVR", 0x28: "CCCR", 0x2C: "PWRCR"}),
    ("RCC", 0x5802_4400, 0x400, _RCC),
    ("PWR", 0x5802_4800, 0x400, {0: "CR1", 4: "CSR1", 8: "CR2", 0xC: "CR3", 0x10: "CPUCR", 0x18: "D3CR"}),
    ("IWDG1", 0x5800_4800, 0x400, {0: "KR", 4: "PR", 8: "RLR", 0xC: "SR", 0x10: "WINR"}),
    ("DBGMCU", 0x5C00_1000, 0x1000, {0: "IDC", 4: "CR", 0x34: "APB3FZR1", 0x3C: "APB1LFZR1", 0x4C: "APB2FZR1", 0x54: "APB4FZR1"}),
    ("ITM", 0xE000_0000, 0x1000, {}),
    ("DWT", 0xE000_1000, 0x1000, {0: "CTRL", 4: "CYCCNT"}),
    ("SYST", 0xE000_E010, 0x10, {0: "CSR", 4: "RVR", 8: "CVR", 0xC: "CALIB"}),
    ("NVIC", 0xE000_E100, 0x400, {0: "ISER0"}),
    ("MPU", 0xE000_ED90, 0x20, {0: "TYPE", 4: "CTRL", 8: "RNR", 0xC: "RBAR", 0x10: "RASR"}),
    ("SCB", 0xE000_ED00, 0x300, {
        0: "CPUID", 4: "ICSR", 8: "VTOR", 0xC: "AIRCR", 0x10: "SCR", 0x14: "CCR", 0x24: "SHCSR", 0x28: "CFSR",
        0x78: "CLIDR", 0x7C: "CTR", 0x80: "CCSIDR", 0x84: "CSSELR", 0x88: "CPACR", 0xFC: "DEMCR", 0x234: "FPCCR",
        0x250: "ICIALLU", 0x260: "DCISW", 0x268: "DCCMVAC", 0x290: "ITCMCR", 0x294: "DTCMCR"}),
]
for _n, _port in enumerate("ABCDEFGHIJK"):
    _PERIPHERALS.append((f"GPIO{_port}", 0x5802_0000 + 0x400 * _n, 0x400, _GPIO))

RESET = {
    "RCC.CR": 0x0000_0087, "RCC.HSICFGR": 0x4000_0000, "RCC.PLLCKSELR": 0x0202_0200, "RCC.PLLCFGR": 0x01FF_0000,
    "RCC.PLL1DIVR": 0x0101_0280, "RCC.PLL2DIVR": 0x0101_0280, "RCC.PLL3DIVR": 0x0101_0280,
    "RCC.AHB1LPENR": 0x1E03_C023, "RCC.AHB2LPENR": 0xE000_0271, "RCC.AHB3LPENR": 0xF001_1131,
    "PWR.CR1": 0xF000_C000, "PWR.CSR1": 0x0000_6000, "PWR.CR3": 0x0000_0006, "PWR.D3CR": 0x0000_6000,
    "FLASH.ACR": 0x0000_0037, "IWDG1.RLR": 0xFFF, "IWDG1.WINR": 0xFFF,
    "CRS.CR": 0x0000_2000, "CRS.CFGR": 0x2022_BB7F, "TIM1.ARR": 0xFFFF, "TIM2.ARR": 0xFFFF_FFFF,
    "USART3.ISR": 0x0000_00C0,
    "ETH.MACCR": 0x0000_8000, "ETH.MACA0HR": 0x8000_FFFF, "ETH.MACA0LR": 0xFFFF_FFFF, "ETH.MACA1HR": 0x0000_FFFF,
    "ETH.MACA1LR": 0xFFFF_FFFF, "ETH.MTLTXQOMR": 0x0007_0008, "ETH.MTLRXQOMR": 0x0070_0000, "ETH.DMASBMR": 0x0101_0000,
    "OTG_FS.GUSBCFG": 0x0000_1400, "OTG_FS.GRSTCTL": 0x8000_0000, "OTG_FS.GINTSTS": 0x0400_0020, "OTG_FS.CID": 0x0000_2300,
    "OTG_FS.DCFG": 0x0220_0000, "OTG_FS.DCTL": 0x0000_0002, "OTG_FS.DSTS": 0x0000_0010, "OTG_FS.GRXFSIZ": 0x0000_0400,
    "OTG_FS.DIEPTXF0": 0x0200_0400,
    "MPU.TYPE": 0x0000_1000, "SCB.CPUID": 0x411F_C271, "SCB.VTOR": 0x0800_0000, "SCB.AIRCR": 0xFA05_0000,
    "SCB.CCR": 0x0004_0200, "SCB.CLIDR": 0x0900_0003, "SCB.CTR": 0x8303_C003, "SCB.CCSIDR": 0xF00F_E019, "SCB.FPCCR": 0xC000_0000,
    "SCB.ITCMCR": 0x0000_0001, "SCB.DTCMCR": 0x0000_0001,
    "GPIOA.MODER": 0xABFF_FFFF, "GPIOA.OSPEEDR": 0x0C00_0000, "GPIOA.PUPDR": 0x6400_0000,
    "GPIOB.MODER": 0xFFFF_FEBF, "GPIOB.OSPEEDR": 0x0000_00C0, "GPIOB.PUPDR": 0x0000_0100,
}
for _port in "CDEFGHIJK":
    RESET[f"GPIO{_port}.MODER"] = 0xFFFF_FFFF

_names = {}


def _peripheral(address):
    for name, base, size, registers in _PERIPHERALS:
        if base <= address < base + size:
            return name, address - base, registers
    return None


def name(address):
    """The name of the register at a word's address."""
    known = _names.get(address)
    if known is None:
        found = _peripheral(address)
        if found is None:
            known = f"{address:#010x}"
        else:
            peripheral, offset, registers = found
            if peripheral == "NVIC":
                block = {0x000: "ISER", 0x080: "ICER", 0x100: "ISPR", 0x180: "ICPR", 0x200: "IABR"}.get(offset & ~0x7F)
                known = f"NVIC.IPR{(offset - 0x300) // 4}" if offset >= 0x300 else f"NVIC.{block}{(offset & 0x7F) // 4}"
            elif peripheral == "SCB" and 0x18 <= offset < 0x24:
                known = f"SCB.SHPR{(offset - 0x14) // 4}"
            else:
                known = f"{peripheral}.{registers.get(offset, f'{offset:#x}')}"
        _names[address] = known
    return known
