// Asking the operator for what a command needs.

const $ = (id) => document.getElementById(id);

/** Ask until it is done or given up. `fields`: name, label, value, hint, required. `run` gets the values. */
export function ask(title, text, fields, doneWord, run) {
  const dialog = $("ask");
  if (dialog.open) return;
  $("asktitle").textContent = title;
  $("asktext").textContent = text;
  $("askproblem").textContent = "";
  $("askdone").firstChild.textContent = `${doneWord} `;
  $("askfields").replaceChildren(
    ...fields.map((field) => {
      const label = document.createElement("label"), input = document.createElement("input");
      label.textContent = field.label;
      input.name = field.name;
      input.type = field.secret ? "password" : "text";
      input.value = field.value ?? "";
      input.placeholder = field.hint ?? "";
      input.maxLength = field.most ?? 80;
      input.required = field.required ?? false;
      input.autocomplete = "off";
      input.spellcheck = false;
      label.append(input);
      return label;
    }),
  );
  // until the next picture a browser leaves the focus in a dialog that is closed: keys would go there
  const close = () => {
    dialog.close();
    if (dialog.contains(document.activeElement)) document.activeElement.blur();
  };
  $("askleave").onclick = dialog.oncancel = close;
  const form = dialog.querySelector("form");
  form.onsubmit = async (event) => {
    event.preventDefault();
    const values = Object.fromEntries([...form.querySelectorAll("input")].map((i) => [i.name, i.value.trim()]));
    try {
      await run(values);
      close();
    } catch (error) {
      $("askproblem").textContent = error.message;
    }
  };
  dialog.showModal();
  dialog.querySelector("input")?.select();
}
