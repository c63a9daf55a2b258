#!/usr/bin/env python3
"""messages.py [--list] PROJECT_ROOT: every error and warning of the sources is in
docs/troubleshooting.md.

Takes the string literals of each XxxError(...) and of each line that begins with
WARNING or ERROR, joins neighbours, and looks for their parts of at least 12
letters in the document. --list prints the messages, with ... for variables."""

import pathlib
import re
import sys

START = re.compile(r'\b(?:(?:Usage|Input|Solver|Output)Error|FolderInUse)\(|"(?:WARNING|ERROR): ')
# A literal, a comment or any other single character.
TOKEN = re.compile(r'"((?:[^"\\]|\\.)*)"|//[^\n]*|\'(?:[^\'\\]|\\.)+\'|.', re.S)
MIN_LENGTH = 12


def statement(text, begin):
    """Tokens from `begin` to the end of the call or statement."""
    depth = 0
    for match in TOKEN.finditer(text, begin):
        yield match
        character = match.group(0)
        depth += (character == "(") - (character == ")")
        if character == ";" or depth < 0:
            return


def messages(text):
    for start in START.finditer(text):
        parts, joined = [], True
        for token in statement(text, start.start()):
            if token.group(1) is not None:
                literal = token.group(1).replace('\\"', '"').replace("\\n", " ")
                if joined and parts:
                    parts[-1] += literal
                else:
                    parts.append(literal)
                joined = True
            elif not token.group(0).isspace() and not token.group(0).startswith("//"):
                joined = False
        yield [part for part in parts if part.strip()]


def normalized(text):
    return re.sub(r"[\s|`\\]+", " ", text)


def sources(root):
    for folder in ("src", "colmap_ext"):
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in (".cc", ".h"):
                yield path


def main():
    arguments = sys.argv[1:]
    list_only = "--list" in arguments
    root = pathlib.Path([a for a in arguments if a != "--list"][0])
    document = normalized((root / "docs/troubleshooting.md").read_text()) if not list_only else ""
    count, missing = 0, []
    for path in sources(root):
        for parts in messages(path.read_text()):
            if list_only:
                print(f"{path.relative_to(root)}: {' ... '.join(parts)}")
            for part in parts:
                # Letters around a number's format.
                for piece in re.split(r"%[-+.0-9]*[a-z]+", part):
                    piece = re.sub("^(WARNING|ERROR): ", "", normalized(piece).strip())
                    if len(re.sub(r"[^A-Za-z]", "", piece)) < MIN_LENGTH:
                        continue
                    count += 1
                    if piece not in document:
                        missing.append(f"{path.relative_to(root)}: {piece}")
    if list_only:
        return 0
    for line in missing:
        print("not in docs/troubleshooting.md:", line)
    print(f"{count} parts of messages, {len(missing)} missing")
    return 1 if missing or count == 0 else 0


if __name__ == "__main__":
    sys.exit(main())
