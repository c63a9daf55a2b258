#!/bin/bash
# links_test.sh PROJECT_ROOT: every link of the documents to a file, and to a
# heading of a document, exists.
set -euo pipefail
cd "$1"

# anchors FILE: of its headings, as GitHub makes them.
anchors() {
  sed -nE 's/^#+ (.*)$/\1/p' "$1" | tr '[:upper:]' '[:lower:]' |
    sed -E 's/[^a-z0-9 _-]//g; s/ /-/g'
}

status=0
num_links=0
for document in *.md docs/*.md; do
  folder=$(dirname "$document")
  while IFS= read -r link; do
    num_links=$((num_links + 1))
    path=${link%%#*}
    anchor=
    [[ $link != *#* ]] || anchor=${link#*#}
    target=$document
    [[ -z $path ]] || target=$folder/$path
    if [[ ! -e $target ]]; then
      echo "$document: there is no $link"
      status=1
    elif [[ -n $anchor ]] && ! anchors "$target" | grep -xF "$anchor" >/dev/null; then
      echo "$document: there is no heading $link"
      status=1
    fi
  done < <(grep -oE '\]\([^)]+\)' "$document" | sed -E 's/^\]\((.*)\)$/\1/' | grep -vE '^[a-z]+:' || true)
done
((num_links > 0)) || { echo "no link found at all" && exit 1; }
((status)) || echo "$num_links links checked"
exit "$status"
