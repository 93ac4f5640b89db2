"""Pages of the site that are no documents of their own: the README, and the names of Python."""

import re

from make.places import ROOT

from quatprop.base import __version__


def on_config(config):
    """Show the version next to the name."""
    config.site_name = f"quatprop {__version__}"
    return config


def on_files(files, config):
    """Add them, as MkDocs asks for them; the README is read from the folder of the documents."""
    from mkdocs.structure.files import File

    readme = (ROOT / "README.md").read_text("utf-8").replace("](quatprop/docs/", "](")
    # Files of the repository that are no documents are not on the site.
    readme = re.sub(r"\[([^]]*)\]\((?!http)(?:[\w./]*/)?[\w.]+(?<!\.md)(?<!\.svg)\)", r"\1", readme)
    readme = readme.replace("[Changes](CHANGELOG.md)", "CHANGELOG.md")
    names = "# Names of Python\n\n::: quatprop\n"
    for name, content in (("index.md", readme), ("python.md", names)):
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown, page, **_others):
    """Leave whole docstrings out of the search, which finds each name on the page of names."""
    if page.file.src_uri == "api.md":
        page.meta["search"] = {"exclude": True}
    return markdown
