  function csv_of(link) {
    const text = link.getAttribute("href"), comma = text.indexOf(","), body = text.slice(comma + 1);
    if (!text.slice(0, comma).endsWith(";base64")) return decodeURIComponent(body);
    return new TextDecoder().decode(Uint8Array.from(atob(body), (sign) => sign.charCodeAt(0)));
  }
  function rows_of(text) {
    const rows = [];
    let row = [], cell = "", quoted = false;
    for (let k = 0; k < text.length; k++) {
      const sign = text[k];
      if (quoted) {
        if (sign !== '"') cell += sign;
        else if (text[k + 1] === '"') { cell += '"'; k++; } else quoted = false;
      } else if (sign === '"') quoted = true;
      else if (sign === "," || sign === "\n") {
        row.push(cell); cell = "";
        if (sign === "\n") { rows.push(row); row = []; }
      } else cell += sign;
    }
    return rows;
  }
