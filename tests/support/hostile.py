"""Words that a spreadsheet, a page, a terminal or a parser would obey."""

from html.parser import HTMLParser

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


class Elements(HTMLParser):
    """Elements with the names of their attributes, and the texts of a page."""

    def __init__(self, page):
        super().__init__()
        self.elements, self.values, self.texts = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, *(name for name, _ in attrs)))
        self.values += [value for _, value in attrs]

    def handle_data(self, data):
        self.texts.append(data)
