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
  $("askleave").onclick = () => dialog.close();
  const form = dialog.querySelector("form");
  form.onsubmit = async (event) => {
    event.preventDefault();
    const values = Object.fromEntries([...form.querySelectorAll("input")].map((i) => [i.name, i.value.trim()]));
    try {
      await run(values);
      dialog.close();
    } catch (error) {
      $("askproblem").textContent = error.message;
    }
  };
  dialog.showModal();
  dialog.querySelector("input")?.select();
}
