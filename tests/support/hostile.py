"""Words that a spreadsheet, a page, a terminal or a parser would obey."""

LINES = (
    '=HYPERLINK("http://a.b","x")',
    "+1;=2,@SUM(3)",
    "\"=1+1'",
    "'=1",
    " -1",
    "＝1",
    "<script>alert(1)</script>",
    "</script><img src=x onerror=alert(1)>",
    '" onload="alert(1)',
    "[a](http://a.b) ![b](http://a.b) <http://a.b>",
    "**a** _b_ `c` ~~d~~ $e$",
    "| a | b |",
    "# a",
    "1. a",
    "- a",
    "&lt;b&gt; &#60;",
    "a: b # c",
    "{a: [b",
    "{{script}}",
    "[red]a[/red] [link=http://a.b]b[/link]",
)
#: With characters that no line of text holds.
CONTROLS = (
    "a\x1b]0;b\x07\x1b[2Jc",
    "a\x9b31mb",
    "a\rb",
    "a\u202eb\u2066c",
    "a\u2028b",
    "a\x00b",
    "\t=1",
    "a\n---\nlicense: mit",
    "caf\udce9",
    "a\u200bb\ufeffc\U000e0041",
)
WORDS = (*LINES, *CONTROLS)
