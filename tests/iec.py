"""A small interpreter of Structured Text: blark reads it, this walks the tree. It knows nothing of the exporter.

It is stricter than most compilers: names are declared once whatever their case, reals are no truth values, whole
numbers are no reals, an index stays inside its array, and an output is read only after it was written.
"""

import math
import re

# IEC 61131-3, Annex C (and the third edition's object words): no variable may have these names.
KEYWORDS = set(
    """ABS ACOS ACTION ADD AND ANDN ANY ARRAY ASIN AT ATAN BOOL BY BYTE CAL CALC CALCN CASE CD CDT CLK CONCAT
    CONFIGURATION CONSTANT COS CTD CTU CTUD CU CV D DATE DELETE DINT DIV DO DS DT DWORD ELSE ELSIF END_CASE END_FOR
    END_FUNCTION END_FUNCTION_BLOCK END_IF END_REPEAT END_STRUCT END_TYPE END_VAR END_WHILE EN ENO EQ ET EXIT EXP EXPT
    FALSE FIND FOR FROM FUNCTION FUNCTION_BLOCK GE GT IF IN INITIAL_STEP INSERT INT INTERVAL JMP JMPC JMPCN L LD LDN LE
    LEFT LEN LIMIT LINT LN LOG LREAL LT LWORD MAX MID MIN MOD MOVE MUL MUX N NE NEG NON_RETAIN NOT OF ON OR ORN P PRIORITY
    PROGRAM PT PV Q Q1 QU QD R R1 READ_ONLY READ_WRITE REAL RELEASE REPEAT REPLACE RESOURCE RET RETAIN RETC RETCN RETURN
    RIGHT ROL ROR RS RTC S S1 SD SEL SEMA SHL SHR SIN SINGLE SINT SL SQRT SR ST STEP STN STRING STRUCT SUB TAN TASK THEN
    TIME TO TOD TOF TON TP TRANSITION TRUE TYPE UDINT UINT ULINT UNTIL USINT VAR VAR_INPUT VAR_OUTPUT VAR_TEMP WHILE
    WITH WORD XOR XORN CLASS METHOD INTERFACE SUPER THIS NAMESPACE USING NULL REF""".split()
)
IDENTIFIER = re.compile(r"[A-Za-z](_?[A-Za-z0-9])*")  # no underscores side by side or at the end
KINDS = {"LREAL": float, "REAL": float, "BOOL": bool, "DINT": int, "UDINT": int}


def extreme(choose):
    return lambda a, b: choose(real(a), real(b))


def real(x):
    assert type(x) is float, f"a real is needed, not {x!r}"
    return x


def truth(x):
    assert type(x) is bool, f"a truth value is needed, not {x!r}"
    return x


def alike(a, b):
    assert type(a) is type(b) and type(a) is not bool, f"{a!r} and {b!r} are of different types"


def exponential(x):
    try:
        return math.exp(real(x))
    except OverflowError:  # a controller goes on with infinity
        return math.inf


FUNCTIONS = {
    "ABS": lambda x: abs(real(x)), "SQRT": lambda x: math.sqrt(real(x)), "EXP": exponential,
    "LN": lambda x: math.log(real(x)), "SIN": lambda x: math.sin(real(x)), "COS": lambda x: math.cos(real(x)),
    "TAN": lambda x: math.tan(real(x)), "ASIN": lambda x: math.asin(real(x)), "ACOS": lambda x: math.acos(real(x)),
    "ATAN": lambda x: math.atan(real(x)), "EXPT": lambda a, b: math.pow(real(a), real(b)),
    "MAX": extreme(max), "MIN": extreme(min), "LIMIT": lambda low, x, high: min(max(real(low), real(x)), real(high)),
    "SEL": lambda which, a, b: real(b) if truth(which) else real(a),
    "UDINT_TO_LREAL": lambda n: float(n), "UDINT_TO_REAL": lambda n: float(n),
}  # fmt: skip


class Block:
    """One instance of the last block or program in a source; calling it is one scan. It may use those before it."""

    def __init__(self, source, name=None):
        from blark.parse import parse_source_code

        parsed = parse_source_code(source)
        assert parsed.exception is None, parsed.exception
        items = parsed.transform().items
        self.block = next(i for i in items if str(i.name) == name) if name else items[-1]
        self.blocks = {str(i.name): source for i in items if i is not self.block}
        self.kinds, self.values, self.inputs, self.outputs, self.temporary = {}, {}, [], [], {}
        self.named(str(self.block.name))
        for section in self.block.declarations:
            kind = type(section).__name__
            for item in section.items:
                for declared in item.variables:
                    self.declare(self.named(str(declared.variable.name)), item.init, kind)

    def named(self, name):
        assert IDENTIFIER.fullmatch(name) and len(name) <= 32, f"{name} is no identifier"
        assert name.upper() not in KEYWORDS, f"{name} is a keyword"
        assert name.upper() not in self.kinds, f"{name} is declared twice"
        self.kinds[name.upper()] = None
        return name.upper()

    def declare(self, name, init, section):
        if type(init).__name__ == "ArrayTypeInitialization":
            (bounds,) = init.spec.subranges
            first, last = self(bounds.start), self(bounds.stop)
            self.kinds[name] = kind = KINDS[str(init.spec.type.type_name)]
            self.values[name] = dict.fromkeys(range(first, last + 1), kind(0))
            assert init.value is None, "blark takes minutes for a list of numbers: fill `values`"
            return
        if str(init.spec.type) in self.blocks:
            self.kinds[name], kind = Block, str(init.spec.type)
            self.values[name] = Block(self.blocks[kind], kind)
            return
        self.kinds[name] = kind = KINDS[str(init.spec.type)]
        self.values[name] = kind(0) if init.value is None else self(init.value)
        assert type(self.values[name]) is kind
        if section == "InputDeclarations":
            self.inputs.append(name)
        elif section == "OutputDeclarations":
            self.outputs.append(name)
        elif section == "TemporaryVariableDeclarations":
            self.temporary[name] = None

    def scan(self, **given):
        """Run once; returns the output."""
        for name, value in given.items():
            assert name.upper() in self.inputs and type(value) is self.kinds[name.upper()], f"{name} is given {value!r}"
            self.values[name.upper()] = value
        self.values |= self.temporary  # what a call leaves behind is gone
        self.run(self.block.body.statements)
        return self.values[self.outputs[0]] if self.outputs else None

    def run(self, statements):
        for s in statements:
            getattr(self, type(s).__name__)(s)

    # -- statements

    def AssignmentStatement(self, s):
        (target,) = s.variables
        self.assign(target, self(s.expression))

    def assign(self, target, value):
        name = str(getattr(target.name, "name", target.name)).upper()
        assert type(value) is self.kinds[name], f"{name} is given {value!r}"
        assert name not in self.inputs, f"the input {name} is written"
        if type(target).__name__ == "SimpleVariable":
            assert not isinstance(self.values[name], dict)
            self.values[name] = value
        else:
            index = self.index(target)
            assert index in self.values[name], f"{name}[{index}] is outside"
            self.values[name][index] = value

    def index(self, variable):
        ((selector,),) = [e.subscripts for e in variable.elements]
        index = self(selector)
        assert type(index) is int
        return index

    def IfStatement(self, s):
        if truth(self(s.if_expression)):
            self.run(s.statements.statements)
            return
        for clause in s.else_ifs:
            if truth(self(clause.if_expression)):
                self.run(clause.statements.statements)
                return
        if s.else_clause is not None:
            self.run(s.else_clause.statements.statements)

    def ForStatement(self, s):
        step = 1 if s.step is None else self(s.step)
        at, to = self(s.from_), self(s.to)
        while (at <= to) if step > 0 else (at >= to):
            self.assign(s.control, at)
            self.run(s.statements.statements)
            at += step

    def FunctionCallStatement(self, s):
        block = self.values[str(s.name.name).upper()]
        assert isinstance(block, Block), f"{s.name} is no block"
        block.scan(**{str(p.name.name): self(p.value) for p in s.parameters})

    # -- expressions

    def __call__(self, e):
        return getattr(self, type(e).__name__)(e)

    def Real(self, e):
        return float(str(e.value))

    def Integer(self, e):
        return int(str(e.value))

    def Boolean(self, e):
        return str(e.value).upper() == "TRUE"

    def ParenthesizedExpression(self, e):
        return self(e.expr)

    def SimpleVariable(self, e):
        value = self.values[str(e.name).upper()]
        assert value is not None, f"{e.name} is read before it is written"
        return value

    def MultiElementVariable(self, e):
        value = self.values[str(e.name.name).upper()]
        if isinstance(value, Block):
            (field,) = [str(one.field.name).upper() for one in e.elements]
            assert field in value.outputs, f"{field} is no output"
            return value.values[field]
        index = self.index(e)
        assert index in value, f"{e.name.name}[{index}] is outside"
        return value[index]

    def UnaryOperation(self, e):
        value = self(e.expr)
        if str(e.op).upper() == "NOT":
            return not truth(value)
        assert str(e.op) == "-" and type(value) is not bool
        return -value

    def BinaryOperation(self, e):
        operator, a, b = str(e.op).upper(), self(e.left), self(e.right)  # both sides: the standard has no short cut
        if operator in ("AND", "OR"):
            return (truth(a) and truth(b)) if operator == "AND" else (truth(a) or truth(b))
        alike(a, b)
        return {
            "+": lambda: a + b, "-": lambda: a - b, "*": lambda: a * b, "/": lambda: real(a) / real(b),
            "<": lambda: a < b, "<=": lambda: a <= b, ">": lambda: a > b, ">=": lambda: a >= b,
            "=": lambda: a == b, "<>": lambda: a != b,
        }[operator]()  # fmt: skip

    def FunctionCall(self, e):
        arguments = [self(p.value) for p in e.parameters]
        assert all(p.name is None for p in e.parameters)
        return FUNCTIONS[str(e.name.name).upper()](*arguments)
