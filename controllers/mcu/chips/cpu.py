"""The 8085: runs machine code from RAM, an instruction at a time.

It has all documented instructions with their flags and T-states (Intel's MCS-85 user's manual, chapter 5). The
routines of the 1982 control program are in Python, at their addresses: a jump or call there runs `routine` and
returns.
"""

from collections.abc import Callable

from edmsim.controllers.mcu.chips.bus import EPROM, Bus
from edmsim.controllers.mcu.firmware.poscal import BYTE, WORD
from edmsim.errors import InputError

B, C, D, E, H, L, M, A = range(8)  # registers in the order of the instructions; M is the byte that H and L point at
CARRY, PARITY, AUXILIARY, ZERO, SIGN = 0x01, 0x04, 0x10, 0x40, 0x80
_BC, _DE, _HL, _SP = range(4)
_EVEN = [not bin(byte).count("1") & 1 for byte in range(256)]
_CONDITIONS = ((ZERO, 0), (ZERO, 1), (CARRY, 0), (CARRY, 1), (PARITY, 0), (PARITY, 1), (SIGN, 0), (SIGN, 1))


class NoCodeError(InputError):
    """The 8085 reached an address without an instruction."""


class Cpu8085:
    """Registers (B, C, D, E, H, L, nothing, A) and instructions; `routine` is called with an address in EPROM."""

    def __init__(self, memory: Bus, routine: Callable[[int], int]) -> None:
        self._memory = memory
        self._routine = routine
        self.registers = [0] * 8
        self.flags, self.pc, self.sp = 0x02, 0, 0
        self.enabled = self.halted = False

    def step(self) -> int:
        """Run the next instruction; return its T-states. Raises `NoCodeError` for an undocumented byte."""
        if self.pc in EPROM:
            cost = self._routine(self.pc)
            if cost:
                self.pc = self._pop()
            return cost
        at, op = self.pc, self._fetch()
        if op < 0x40:
            return self._low(op, at)
        if op < 0x80:
            if op == 0x76:
                self.halted = True
                return 5
            self._put(op >> 3 & 7, self._get(op & 7))
            return 7 if M in (op >> 3 & 7, op & 7) else 4
        if op < 0xC0:
            self._alu(op >> 3 & 7, self._get(op & 7))
            return 7 if op & 7 == M else 4
        return self._high(op, at)

    def push(self, word: int) -> None:
        """Push a word onto the stack."""
        self.sp = self.sp - 2 & WORD
        self._memory.write(self.sp + 1 & WORD, word >> 8)
        self._memory.write(self.sp, word & BYTE)

    def _pop(self) -> int:
        word = self._word(self.sp)
        self.sp = self.sp + 2 & WORD
        return word

    def _fetch(self) -> int:
        byte = self._memory.read(self.pc)
        self.pc = self.pc + 1 & WORD
        return byte

    def _fetch_word(self) -> int:
        low = self._fetch()
        return low | self._fetch() << 8

    def _word(self, address: int) -> int:
        return self._memory.read(address) | self._memory.read(address + 1 & WORD) << 8

    def _pair(self, pair: int) -> int:
        return self.sp if pair == _SP else self.registers[2 * pair] << 8 | self.registers[2 * pair + 1]

    def _set_pair(self, pair: int, word: int) -> None:
        if pair == _SP:
            self.sp = word & WORD
        else:
            self.registers[2 * pair : 2 * pair + 2] = word >> 8 & BYTE, word & BYTE

    def _get(self, register: int) -> int:
        return self._memory.read(self._pair(_HL)) if register == M else self.registers[register]

    def _put(self, register: int, byte: int) -> None:
        if register == M:
            self._memory.write(self._pair(_HL), byte)
        else:
            self.registers[register] = byte

    def _low(self, op: int, at: int) -> int:
        """Instructions 00H to 3FH: pairs, increments, immediate bytes, rotations."""
        kind, pair, register = op & 7, op >> 4 & 3, op >> 3 & 7
        if kind == 0:
            return self._single(op, at)
        if kind == 1:
            if not op & 8:
                self._set_pair(pair, self._fetch_word())  # LXI
            else:
                total = self._pair(_HL) + self._pair(pair)  # DAD
                self._set_pair(_HL, total)
                self._flag(CARRY, total > WORD)
            return 10
        if kind == 2:
            return self._through_memory(op, pair)
        if kind == 3:
            self._set_pair(pair, self._pair(pair) + (-1 if op & 8 else 1))  # INX, DCX
            return 6
        if kind == 6:
            self._put(register, self._fetch())  # MVI
            return 10 if register == M else 7
        if kind == 7:
            self._accumulator(register)
            return 4
        before = self._get(register)
        after = before + (1 if kind == 4 else -1) & BYTE  # INR, DCR
        self._put(register, after)
        self._flag(AUXILIARY, after & 0xF == 0 if kind == 4 else before & 0xF != 0)
        self._results(after)
        return 10 if register == M else 4

    def _single(self, op: int, at: int) -> int:
        if op == 0x20:
            self.registers[A] = self.enabled << 3  # RIM: no line is wired to it
        elif op not in (0x00, 0x30):  # NOP, SIM
            raise NoCodeError(f"{op:02X}H at {at:04X}H is not an instruction of the 8085")
        return 4

    def _through_memory(self, op: int, pair: int) -> int:
        if pair < _HL:
            if op & 8:
                self.registers[A] = self._memory.read(self._pair(pair))  # LDAX
            else:
                self._memory.write(self._pair(pair), self.registers[A])  # STAX
            return 7
        address = self._fetch_word()
        if pair == _HL:
            if op & 8:
                self._set_pair(_HL, self._word(address))  # LHLD
            else:
                self._memory.write(address, self.registers[L])  # SHLD
                self._memory.write(address + 1 & WORD, self.registers[H])
            return 16
        if op & 8:
            self.registers[A] = self._memory.read(address)  # LDA
        else:
            self._memory.write(address, self.registers[A])  # STA
        return 13

    def _accumulator(self, kind: int) -> None:
        """RLC, RRC, RAL, RAR, DAA, CMA, STC, CMC."""
        a, carry = self.registers[A], self.flags & CARRY
        if kind == 4:
            low = a & 0xF > 9 or self.flags & AUXILIARY
            high = a > 0x99 or carry
            self._add((6 if low else 0) + (0x60 if high else 0), 0)
            self._flag(CARRY, bool(high))
            return
        if kind == 5:
            self.registers[A] = a ^ BYTE
            return
        if kind >= 6:
            self._flag(CARRY, kind == 6 or not carry)
            return
        out = a & 1 if kind & 1 else a >> 7
        into = (carry if kind >= 2 else out) & 1
        self.registers[A] = a >> 1 | into << 7 if kind & 1 else a << 1 & BYTE | into
        self._flag(CARRY, bool(out))

    def _alu(self, kind: int, byte: int) -> None:
        """ADD, ADC, SUB, SBB, ANA, XRA, ORA, CMP with the accumulator."""
        a, carry = self.registers[A], self.flags & CARRY
        if kind < 2:
            self._add(byte, carry if kind == 1 else 0)
        elif kind in (2, 3, 7):
            borrow = carry if kind == 3 else 0
            left = a - byte - borrow
            self._flag(AUXILIARY, (a & 0xF) - (byte & 0xF) - borrow >= 0)
            self._flag(CARRY, left < 0)
            self._results(left & BYTE)
            if kind != 7:
                self.registers[A] = left & BYTE
        else:
            self.registers[A] = a & byte if kind == 4 else a ^ byte if kind == 5 else a | byte
            self._flag(AUXILIARY, kind == 4)
            self._flag(CARRY, False)
            self._results(self.registers[A])

    def _add(self, byte: int, carry: int) -> None:
        a = self.registers[A]
        total = a + byte + carry
        self._flag(AUXILIARY, (a & 0xF) + (byte & 0xF) + carry > 0xF)
        self._flag(CARRY, total > BYTE)
        self.registers[A] = total & BYTE
        self._results(total & BYTE)

    def _results(self, byte: int) -> None:
        self._flag(ZERO, byte == 0)
        self._flag(SIGN, byte >= 0x80)
        self._flag(PARITY, _EVEN[byte])

    def _flag(self, flag: int, up: bool) -> None:
        self.flags = self.flags | flag if up else self.flags & ~flag

    def _high(self, op: int, at: int) -> int:
        """Instructions C0H to FFH: jumps, calls, returns, the stack, immediate arithmetic."""
        kind, pair = op & 7, op >> 4 & 3
        if kind in (0, 2, 4):
            flag, taken_if = _CONDITIONS[op >> 3 & 7]
            return self._branch(kind, bool(self.flags & flag) == bool(taken_if))
        if kind == 6:
            self._alu(op >> 3 & 7, self._fetch())
            return 7
        if kind == 7:
            self.push(self.pc)  # RST
            self.pc = op & 0x38
            return 12
        if not op & 8 and kind in (1, 5):
            return self._stack(kind, pair)
        if op == 0xC9:
            return self._branch(0, True) - 2
        if op == 0xCD:
            return self._branch(4, True)
        if op == 0xC3:
            return self._branch(2, True)
        return self._others(op, at)

    def _branch(self, kind: int, taken: bool) -> int:
        """RET, JMP or CALL, if its condition holds."""
        if kind == 0:
            self.pc = self._pop() if taken else self.pc
            return 12 if taken else 6
        target = self._fetch_word()
        if not taken:
            return 7 if kind == 2 else 9
        if kind == 4:
            self.push(self.pc)
        self.pc = target
        return 10 if kind == 2 else 18

    def _stack(self, kind: int, pair: int) -> int:
        if kind == 5:
            self.push(self.registers[A] << 8 | self.flags if pair == _SP else self._pair(pair))
            return 12
        word = self._pop()
        if pair == _SP:
            self.registers[A], self.flags = word >> 8, word & 0xD7 | 0x02
        else:
            self._set_pair(pair, word)
        return 10

    def _others(self, op: int, at: int) -> int:
        hl = self._pair(_HL)
        if op == 0xE9:  # PCHL
            self.pc = hl
            return 6
        if op == 0xF9:  # SPHL
            self.sp = hl
            return 6
        if op == 0xEB:  # XCHG
            self._set_pair(_HL, self._pair(_DE))
            self._set_pair(_DE, hl)
            return 4
        if op == 0xE3:  # XTHL
            self._set_pair(_HL, self._pop())
            self.push(hl)
            return 16
        if op in (0xF3, 0xFB):  # DI, EI
            self.enabled = op == 0xFB
            return 4
        if op in (0xD3, 0xDB):  # OUT, IN: chips are memory-mapped, and these ports are empty
            self._fetch()
            if op == 0xDB:
                self.registers[A] = BYTE
            return 10
        raise NoCodeError(f"{op:02X}H at {at:04X}H is not an instruction of the 8085")
