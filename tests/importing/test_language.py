"""The language of scripts of LIGGGHTS and LAMMPS."""

import pytest

from granflow.importing import language
from granflow.importing.language import DeckError, Interpreter, NotKnown


def commands(tmp_path, text, **given):
    """The commands of a script, as lists of words."""
    path = tmp_path / "in.deck"
    path.write_text(text)
    return [
        [each.name, *each.words] for each in Interpreter(given=given, unneeded={"processors"}).commands(path)
    ]


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        ("2+3*4", 14),
        ("-2^2", -4),
        ("2^3^2", 512),  # from the right
        ("(1+2)/4", 0.75),
        ("1.5e-3*2", 3e-3),
        ("sqrt(16)+exp(0)", 5),
        ("ln(exp(2))+log(100)", 4),
        ("cos(PI)", -1),
        ("7%4", 3),
        ("1<2 && 3>=3", 1),
        ("!1 || 2!=2", 0),
        ("v_a*2", 6),
        ("ternary(1>0,5,6)", 5),
        ("ceil(1.2)+floor(1.8)+round(1.5)", 5),
        ("step*2", 0),
    ],
)
def test_formula(formula, value):
    interpreter = Interpreter(given={"a": "3"})
    assert interpreter.evaluate(formula) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("formula", ["c_1+2", "mass(all)", "2*", "(1", "nothing", "1/0", "1 2"])
def test_formula_without_value(formula):
    with pytest.raises(NotKnown):
        Interpreter().evaluate(formula)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("run 10 # comment", [["run", "10"]]),
        ("run &\n  10 &\n upto", [["run", "10", "upto"]]),
        ("fix 1 all print 'a # b' c", [["fix", "1", "all", "print", "a # b", "c"]]),
        ('fix 1 all print """a "b" c"""', [["fix", "1", "all", "print", 'a "b" c']]),
        ("variable n equal 2*3\nrun $n\nrun ${n}", [["run", "6"], ["run", "6"]]),
        ("run $(2*(3+4))", [["run", "14"]]),
        ("variable d equal 0.1+0.2\nx ${d}", [["x", "0.3"]]),
        ("variable s string 'a b'\nx ${s}", [["x", "a", "b"]]),
        ('variable a equal 2\nif "$a > 1" then "run 1" "run 2" else "run 3"', [["run", "1"], ["run", "2"]]),
        ('if "yes == no" then "run 1" elif "2 == 2" "run 2" else "run 3"', [["run", "2"]]),
        ("variable i loop 2\nlabel l\nx $i\nnext i\njump SELF l\ny", [["x", "1"], ["x", "2"], ["y"]]),
        ("variable i index 5 7\nlabel l\nx ${i}\nnext i\njump SELF l", [["x", "5"], ["x", "7"]]),
        ("variable d file values\nlabel l\nx $d\nnext d\njump SELF l", [["x", "0.1"], ["x", "0.2"]]),
        ("jump SELF end\nx 1\nlabel end\nx 2", [["x", "2"]]),
        ("variable a equal 1\nvariable b equal v_a+1\nvariable a equal 5\nx ${b}", [["x", "6"]]),
        ("variable given equal 2\nvariable b index 3\nx ${given} $b", [["x", "7", "3"]]),
        ("x 1\nquit\nx 2", [["x", "1"]]),
        ("print 'the rate is ${given}'\nx 1", [["x", "1"]]),
        ("variable a equal c_1\nvariable b equal 2*${a}\nprint 'it is ${b} and $(v_a+1)'\nx 1", [["x", "1"]]),
        ("variable a world 1 2\nx $a", [["x", "1"]]),
        ('variable m string a\nif "$m == a && 1 < 2" then "x 1"', [["x", "1"]]),
        ('variable m string a\nif "$m == b && 1 < 2 || $m == a" then "x 1" else "x 2"', [["x", "1"]]),
        ('variable m string a\nif "$m != a || 3 < 2" then "x 1" else "x 2"', [["x", "2"]]),
        ("run 10 every 5 NULL", [["run", "10"]]),
        ("run 10 pre no every 5 'print a'", [["run", "10", "pre", "no"]]),
        (
            "variable a equal 1\nrun 3 every 2 'x $a' 'variable a equal $a+1'",
            [["run", "2"], ["x", "1"], ["run", "1"], ["x", "2"]],
        ),
        ("include inner\ny $k", [["x", "4"], ["y", "4"]]),
        ("include parts/from_folder", [["x", "4"]]),
        ("include parts/from_file", [["z", "1"]]),
        # unknown variables of lines that a scene does not need
        (
            "processors $n 1 1\nlog ${file}.txt\nx 1",
            [["processors", "$n", "1", "1"], ["x", "1"]],
        ),
    ],
)
def test_commands(tmp_path, text, expected):
    """The codes take names from the folder where they are started; next to the file is taken as well."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "values").write_text("# sizes\n0.1\n\n0.2 # the last\n")
    (tmp_path / "inner").write_text("variable k equal 4\nx $k\n")
    (tmp_path / "parts/near").write_text("z 1\n")
    (tmp_path / "parts/from_folder").write_text("include inner\n")
    (tmp_path / "parts/from_file").write_text("include near\n")
    assert commands(tmp_path, text, given="7") == expected


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("x ${a}\ny $b $(v_c+v_a)", 1, "no variable a; give a, b and c with --set NAME=VALUE"),
        ("x 1\nx ${none}", 2, "there is no variable none"),
        ("label l\njump SELF l", 2, "the loop has no end"),
        ("jump SELF nowhere", 1, "no label nowhere"),
        ("x 'a b", 1, "is not closed"),
        ("include nothing", 1, "cannot be read"),
        ("include in.deck", 1, "include each other"),
        ("variable a getenv HOME", 1, "--set a=VALUE"),
        ("variable a wonder 1 2", 1, "style wonder"),
        ("variable a equal c_1\nrun ${a}", 2, "c_1 is a result of the simulation"),
        ("print '${none}'", 1, "there is no variable none"),
        ('if "c_1 > 2" then "x 1"', 1, "cannot be decided"),
        ('if "1 > 2"', 1, "the form is"),
        ("run 5 every 0 'x 1'", 1, "every is 0"),
        ("run 5 every 2", 1, "the form is run N every M"),
        ("variable a loop x", 1, "the end of the loop is x"),
        ("variable a equal 3\nnext a", 2, "next takes index and loop"),
        ("variable v atom x\nx ${v}", 2, "one value per particle"),
    ],
)
def test_errors_have_the_line(tmp_path, monkeypatch, text, line, part):
    monkeypatch.setattr(language, "MOST_COMMANDS", 1000)
    with pytest.raises(DeckError, match=part) as caught:
        commands(tmp_path, text)
    assert str(caught.value).startswith(f"in.deck:{line}: ")
