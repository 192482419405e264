'use strict';
const place = (name) => document.getElementById(name);
const made = (tag, text, attributes = {}) => {
  const element = document.createElement(tag);
  if (text) element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
};
let state = { text: '', revision: '', fields: [] };
let kind = 'check';
let wanted = null;  // what to ask for as soon as the last answer is there
let asking = false;

function complain(text) {
  place('problem').textContent = text || '';
  place('problem').hidden = !text;
}

function say(notes) {
  place('said').textContent = (notes || []).join('\n');
  place('said').hidden = !(notes || []).length;
}

async function told(path, options = {}) {
  try {
    const answer = await fetch(path, options);
    if (!answer.ok) return { error: (await answer.text()).trim() || 'this was refused; what was saved is kept' };
    return await answer.json();
  } catch {
    return { error: "no answer: start 'dqforge serve' once more; what was saved is kept" };
  }
}

const posted = (path, data) => told(path, {
  method: 'POST', headers: { 'Content-Type': 'application/json' },
  body: JSON.stringify({ ...data, revision: state.revision }),
});

// The design: its fields and its text.

const change = async (path, data) => settled(await posted(path, data));

function settled(found) {
  complain(found.error);
  say(found.notes);
  if (found.text === undefined) return false;
  take(found);
  if (found.stale) return false;
  ask();
  return true;
}

function take(found) {
  state = found;
  place('begin').hidden = Boolean(state.text);
  place('work').hidden = !state.text;
  place('text').value = state.text;
  draw();
}

function draw() {
  const held = document.activeElement && document.activeElement.id;
  const sections = new Map();
  for (const field of state.fields) {
    const section = field.key.includes('.') ? field.key.split('.')[0] : 'design';
    if (!sections.has(section)) sections.set(section, []);
    sections.get(section).push(field);
  }
  const fields = place('fields');
  fields.replaceChildren();
  for (const [section, inside] of sections) {
    const box = made('fieldset');
    box.append(made('legend', section));
    for (const field of inside) box.append(drawn(field, section));
    fields.append(box);
  }
  if (held && place(held)) place(held).focus();
}

const NUMBER = /^([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(\s.*|)$/;
const SPAN = 4;  // a slider goes from a quarter to four times the value

function drawn(field, section) {
  const id = `field-${field.key}`;
  const box = made('div', '', { class: 'field' });
  box.append(made('label', field.key.startsWith(`${section}.`) ? field.key.slice(section.length + 1) : field.key, { for: id }));
  const input = field.choices.length ? made('select', '', { id }) : made('input', '', { id, autocomplete: 'off' });
  for (const choice of field.choices) input.append(made('option', choice, { value: choice }));
  input.value = field.value;
  input.addEventListener('change', () => change('/api/set', { settings: [`${field.key}=${input.value}`] }));
  box.append(input);
  const number = NUMBER.exec(field.value);
  if (number && Number(number[1]) !== 0 && !field.whole && section !== 'design') box.append(slider(field, number, input));
  if (field.help) {
    box.append(made('p', field.help, { class: 'help', id: `${id}-help` }));
    input.setAttribute('aria-describedby', `${id}-help`);
  }
  return box;
}

function slider(field, number, input) {
  const range = made('input', '', {
    type: 'range', id: `slide-${field.key}`, min: -1, max: 1, step: 0.02, value: 0,
    'aria-label': `${field.key}, from a quarter to four times`,
  });
  const text = () => `${Number((Number(number[1]) * SPAN ** Number(range.value)).toPrecision(4))}${number[2]}`;
  range.addEventListener('input', () => {
    input.value = text();
    range.setAttribute('aria-valuetext', input.value);
    ask([`${field.key}=${input.value}`]);
  });
  range.addEventListener('change', () => change('/api/set', { settings: [`${field.key}=${text()}`] }));
  return range;
}

// Answers: one at a time, the latest question next.

function ask(settings = []) {
  if (!state.text) return;
  wanted = settings;
  if (!asking) next();
}

async function next() {
  asking = true;
  while (wanted) {
    const settings = wanted;
    wanted = null;
    place('busy').textContent = `${kind} ...`;
    const options = { speed: place('speed').value, torque: place('torque').value };
    const found = await posted('/api/answer', { kind, settings, options });
    if (!wanted) show(found);
  }
  place('busy').textContent = '';
  asking = false;
}

function show(found) {
  const answer = place('answer');
  answer.replaceChildren();
  if (found.error) {
    answer.append(made('p', found.error, { class: 'wrong' }));
    return;
  }
  if (found.figure) {
    const figure = made('figure');
    const data = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(found.figure)}`;
    figure.append(made('img', '', { src: data, alt: `Figure of ${kind} for ${found.name}; its numbers are in the tables below.` }));
    answer.append(figure);
  }
  for (const table of found.tables) answer.append(tabled(table));
  const notes = made('div', '', { class: 'notes' });
  for (const note of found.notes) notes.append(made('p', note));
  answer.append(notes);
}

// A cell that begins with a number is not broken; the table scrolls.
const NUMBERED = /^[-+]?\d.{0,40}$/;

function tabled(table) {
  const box = made('div', '', { class: 'scroll', tabindex: 0, role: 'region', 'aria-label': table.title || 'table' });
  const element = made('table');
  if (table.title) element.append(made('caption', table.title));
  if (table.columns.some((column) => column)) {
    const row = made('tr');
    for (const column of table.columns) row.append(column ? made('th', column, { scope: 'col' }) : made('td'));
    const head = made('thead');
    head.append(row);
    element.append(head);
  }
  const body = made('tbody');
  for (const cells of table.rows) {
    const row = made('tr');
    for (const cell of cells) row.append(made('td', cell, NUMBERED.test(cell) ? { class: 'whole' } : {}));
    body.append(row);
  }
  element.append(body);
  box.append(element);
  for (const note of table.notes) box.append(made('p', note, { class: 'help' }));
  return box;
}

// What is pressed.

place('sheet').addEventListener('submit', async (event) => {
  event.preventDefault();
  const sheet = Object.fromEntries([...new FormData(event.target)].filter(([, text]) => typeof text === 'string' && text.trim()));
  const form = new FormData();
  form.append('asked', JSON.stringify({
    sheet, revision: state.revision, axes: place('axes').value, scale: place('scale').value, line_to_line: Boolean(place('channels').value),
  }));
  try {
    for (const field of ['map', 'capture']) for (const file of place(field).files) form.append(field, await held(file), file.name);
  } catch (error) {
    complain(error.message);
    return;
  }
  place('busy-new').textContent = 'reading ...';
  const found = await told('/api/new', { method: 'POST', body: form });
  place('busy-new').textContent = '';
  if (settled(found)) place('design-title').scrollIntoView();
});

// The content of a file as it is now: what was chosen may have changed since, or be a folder.
async function held(file) {
  const largest = Number(place('sheet').dataset.largest);
  const many = [...place('map').files, ...place('capture').files].reduce((sum, one) => sum + one.size, 0);
  if (many > largest) throw new Error(`${file.name}: ${(many / 1e6).toFixed(0)} MB are too much; files of ${largest / 1e6} MB together are taken here, larger ones by 'dqforge new'`);
  try {
    return new Blob([await file.arrayBuffer()]);
  } catch {
    throw new Error(`${file.name} cannot be read; choose the file once more`);
  }
}

// A file that misses its zone is not opened in place of the page.
for (const kind of ['dragover', 'drop']) document.addEventListener(kind, (event) => event.preventDefault());
for (const zone of document.querySelectorAll('.drop')) {
  const input = zone.querySelector('input');
  const tell = () => { place(`${input.id}-taken`).textContent = [...input.files].map((file) => `${file.name}, ${Math.ceil(file.size / 1e3)} kB`).join('; '); };
  zone.addEventListener('dragover', () => zone.classList.add('over'));
  zone.addEventListener('dragleave', () => zone.classList.remove('over'));
  zone.addEventListener('drop', (event) => {
    zone.classList.remove('over');
    const { files } = event.dataTransfer;
    if (!files.length) return;
    if (files.length > 1 && !input.multiple) {
      complain(`${files.length} files were dropped; one flux map makes a design`);
      return;
    }
    complain('');
    input.files = files;
    tell();
  });
  input.addEventListener('change', tell);
}
place('library').addEventListener('submit', (event) => {
  event.preventDefault();
  change('/api/template', { machine: place('machine').value.trim() });
});
place('yaml').addEventListener('submit', (event) => {
  event.preventDefault();
  change('/api/text', { text: place('text').value });
});
place('add').addEventListener('submit', async (event) => {
  event.preventDefault();
  if (await change('/api/set', { settings: [`${place('key').value.trim()}=${place('value').value}`] })) event.target.reset();
});
place('key').addEventListener('input', () => {
  const option = [...place('keys').options].find((one) => one.value === place('key').value);
  place('key-help').textContent = (option && option.dataset.help) || '';
});
for (const button of document.querySelectorAll('button.ask')) {
  button.addEventListener('click', () => {
    kind = button.dataset.kind;
    for (const other of document.querySelectorAll('button.ask')) other.setAttribute('aria-pressed', String(other === button));
    place('point').hidden = !['mtpa', 'dqy'].includes(kind);
    ask();
  });
}
for (const name of ['speed', 'torque']) place(name).addEventListener('change', () => ask());
place('download').addEventListener('click', async () => {
  place('busy').textContent = 'export ...';
  const answer = await fetch(`/files.zip?for=${encodeURIComponent(place('target').value)}`);
  place('busy').textContent = '';
  if ((answer.headers.get('Content-Type') || '').startsWith('application/zip')) {
    const name = decodeURIComponent((answer.headers.get('Content-Disposition') || '').split("''")[1] || 'files.zip');
    const link = made('a', '', { href: URL.createObjectURL(await answer.blob()), download: name });
    link.click();
    URL.revokeObjectURL(link.href);
    complain('');
  } else {
    complain((await answer.json()).error);
  }
});

told('/api/state').then((found) => {
  complain(found.error);
  if (found.text !== undefined) take(found);
  ask();
});
