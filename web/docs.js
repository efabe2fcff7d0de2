// Shows the interface's own document; nothing is loaded from elsewhere.

SwaggerUIBundle({
  url: "openapi.json",
  dom_id: "#interface",
  validatorUrl: null,
  tryItOutEnabled: true,
  filter: true,
});
