"""Look at every link of a built site with LinkChecker: `python tests/site_links.py -f CONFIG PAGE`.

Where root starts it, LinkChecker turns itself into nobody, who may not read a site that lies in a
folder of root's own; then it would find but one page, and that one missing. What is read here are
files of ours alone.
"""

from __future__ import annotations

from linkcheck.command import linkchecker


def main() -> None:
    linkchecker.drop_privileges = lambda: None
    linkchecker.linkchecker()


if __name__ == "__main__":
    main()
