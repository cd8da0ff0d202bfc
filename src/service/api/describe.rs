//! Completes the description of the API by what no handler states: the security of each operation,
//! the refusals that precede every handler, objects that an address names, descriptions of responses,
//! the body of errors, and schemas that generators of clients accept.
//! Uses: `routes`, utoipa. Never: a fact that contradicts the table of operations.

use axum::http::Method;
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{
    AdditionalProperties, AllOf, Array, ArrayItems, Components, Object, Schema, SchemaType, Type,
};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    Content, ContentBuilder, HeaderBuilder, OpenApi, Ref, RefOr, Response, ResponseBuilder,
};

use super::access::{Access, Lock, Needs};
use super::examples;
use super::limits::STATUS_AGE_MAX;
use super::routes::AllNeeds;
use crate::dataset::format::Format;
use crate::store::Role;

/// Media type of problem bodies.
const PROBLEM: &str = "application/problem+json";
/// Name of the security scheme.
const KEY: &str = "key";

/// A refusal that precedes a handler: status, name of the shared response, meaning.
type Refusal = (&'static str, &'static str, &'static str);

/// Names refusals, and lists all of them: `NAME: status, response, meaning;`.
macro_rules! refusals {
    ($($name:ident: $status:literal, $response:literal, $meaning:literal;)*) => {
        $(const $name: Refusal = ($status, $response, $meaning);)*
        const ALL: &[Refusal] = &[$($name),*];
    };
}

refusals! {
    BAD_REQUEST: "400", "BadRequest",
        "a parameter is unknown or invalid, or the syntax of the body is invalid";
    NO_KEY: "401", "NoKey", "the key is missing, unknown or revoked";
    FORBIDDEN: "403", "Forbidden",
        "the role is too low, or the request is from a page of another origin";
    NOT_FOUND: "404", "NotFound", "an object that the address names does not exist";
    NOT_ACCEPTED: "406", "NotAccepted", "the header `Accept` permits no format of the response";
    TOO_SLOW: "408", "TooSlow", "the body arrived too slowly";
    LOCKED: "409", "Locked", "another person holds the operator lock";
    TOO_LARGE: "413", "TooLarge", "the body is too large";
    OTHER_TYPE: "415", "OtherType", "the body has another media type";
    CHANGED: "412", "Changed", "no entity tag of `If-Match` is that of the file";
    LONG_ADDRESS: "414", "LongAddress", "path and query are too long";
    BEYOND: "416", "Beyond", "`Range` begins after the end of the file";
    INVALID: "422", "Invalid", "a value of the body is invalid";
    NO_SOCKET: "426", "NoSocket", "the request does not ask for a WebSocket";
    TOO_MANY: "429", "TooMany", "the caller has too many requests in progress";
    LONG_HEADERS: "431", "LongHeaders", "the headers are too many or too long";
    BUSY: "503", "Busy", "all connections are in use, or the service ends";
}

/// Objects that an address names: parameter of the path, its meaning, and why none is found. A handler states only
/// another reason.
const NAMED: [(&str, &str, &str); 6] = [
    ("run", "uid or scan_id", "no run has this uid or scan_id"),
    ("dataset", "id or name", "no dataset has this id, or none of this name has been made"),
    ("export", "id of the export", "no export has this id"),
    ("job", "id of the job", "no job has this id"),
    (
        "model",
        "id of the model, start of the id (`mdl-` and at least 6 digits), or name",
        "no model has this id or name, or several ids begin like this",
    ),
    ("folder", "name of the folder", "no folder of this name has an order"),
];

/// Completes the description of all operations.
pub fn complete(description: &mut OpenApi, all: &AllNeeds) {
    let components = description.components.get_or_insert_default();
    let bearer = HttpBuilder::new()
        .scheme(HttpAuthScheme::Bearer)
        .description(Some(
            "A key of `palpate key create`. A service that listens on a loopback address also admits \
             requests without a key, with the role `operator`.",
        ))
        .build();
    components.add_security_scheme(KEY, SecurityScheme::Http(bearer));
    for &(_, name, meaning) in ALL {
        components.responses.insert(name.into(), RefOr::T(problem(meaning)));
    }
    simplify(components);
    for (path, item) in &mut description.paths.paths {
        let operations = [
            (Method::GET, &mut item.get),
            (Method::PUT, &mut item.put),
            (Method::POST, &mut item.post),
            (Method::DELETE, &mut item.delete),
        ];
        for (method, operation) in operations {
            if let Some((operation, needs)) = operation.as_mut().zip(all.find(&method, path)) {
                complete_operation(operation, &method, needs);
            }
        }
    }
}

fn complete_operation(operation: &mut Operation, method: &Method, needs: &Needs) {
    let required = SecurityRequirement::new::<_, [&str; 0], &str>(KEY, []);
    operation.security = match needs.access {
        Access::Open => Some(vec![]),
        Access::Stop | Access::From(_) => Some(vec![required, SecurityRequirement::default()]),
    };
    let mut refusals = vec![BUSY];
    if needs.access != Access::Stop {
        refusals.extend([LONG_ADDRESS, LONG_HEADERS]);
    }
    if matches!(needs.access, Access::Stop | Access::From(_)) {
        refusals.push(NO_KEY);
    }
    if let Access::From(_) = needs.access {
        refusals.extend([FORBIDDEN, TOO_MANY]);
    }
    describe_named(operation);
    let parameters =
        operation.parameters.iter().flatten().filter_map(|parameter| match parameter {
            RefOr::T(parameter) => Some(parameter),
            RefOr::Ref(_) => None,
        });
    let has = |of: &dyn Fn(&Parameter) -> bool| parameters.clone().any(of);
    if has(&|_| true) {
        refusals.push(BAD_REQUEST);
    }
    if has(&|parameter| parameter.parameter_in == ParameterIn::Path) {
        refusals.push(NOT_FOUND);
    }
    let is_table = has(&|parameter| ["export", "file"].contains(&parameter.name.as_str()));
    let pages = has(&|parameter| parameter.name == "format");
    if operation.request_body.is_some() && needs.access != Access::Stop {
        refusals.extend([BAD_REQUEST, TOO_SLOW, TOO_LARGE, OTHER_TYPE, INVALID]);
    }
    if let Some(RefOr::T(body)) = &mut operation.request_body
        && let Some(RefOr::T(json)) = body.content.get_mut("application/json")
    {
        json.example = operation.operation_id.as_deref().and_then(examples::body);
    }
    if needs.lock != Lock::Ignored {
        refusals.push(LOCKED);
    }
    let responses = &mut operation.responses.responses;
    if responses.contains_key("101") {
        refusals.extend([BAD_REQUEST, NO_SOCKET]);
    }
    if responses.contains_key("206") {
        refusals.extend([CHANGED, BEYOND]);
    }
    let files =
        responses.iter_mut().filter(|(status, _)| ["200", "206"].contains(&status.as_str()));
    for (status, file) in files {
        if let RefOr::T(file) = file
            && let Some(content) = file.content.get("application/octet-stream").cloned()
            && is_table
        {
            let formats = Format::ALL.into_iter();
            file.content.extend(formats.map(|f| (f.media_type().into(), content.clone())));
            if status == "206" {
                file.content.insert("multipart/byteranges".into(), content);
            }
        }
    }
    if pages && let Some(RefOr::T(page)) = responses.get_mut("200") {
        refusals.push(NOT_ACCEPTED);
        let formats = Format::ALL.into_iter().filter(|format| format.streams());
        page.content.extend(formats.map(|format| (format.media_type().into(), table().into())));
    }
    if needs.once {
        describe_repetition(operation, &refusals);
    }
    if needs.moves {
        describe_lateness(operation);
    }
    if needs.edited.is_some() {
        describe_tags(operation, *method == Method::GET);
    }
    let responses = &mut operation.responses.responses;
    for (status, name, _) in refusals {
        responses.entry(status.into()).or_insert(RefOr::Ref(Ref::from_response_name(name)));
    }
    for (status, response) in responses {
        if let RefOr::T(response) = response {
            complete_response(status, response);
        }
    }
    let rights = match (needs.access, needs.lock) {
        (Access::Open, _) => "Needs no key.",
        (Access::Stop, _) => "Needs a valid key of any role; no lock prevents it.",
        (Access::From(Role::Viewer), Lock::RefusesSome) => {
            "Needs the role `viewer` to pause, stop or abort, and `operator` for the other actions, \
             which the operator lock of another person refuses."
        }
        (Access::From(Role::Viewer), _) => "Needs the role `viewer`.",
        (Access::From(Role::Operator), Lock::Ignored) => "Needs the role `operator`.",
        (Access::From(Role::Operator), _) => {
            "Needs the role `operator`; the operator lock of another person refuses it."
        }
        (Access::From(Role::Admin), _) => "Needs the role `admin`.",
    };
    let text = operation.description.get_or_insert_default();
    if !text.is_empty() {
        text.push_str("\n\n");
    }
    text.push_str(rights);
}

/// Describes the objects that the address names, and what is answered if one does not exist.
fn describe_named(operation: &mut Operation) {
    for parameter in operation.parameters.iter_mut().flatten() {
        if let RefOr::T(parameter) = parameter
            && parameter.parameter_in == ParameterIn::Path
            && let Some((_, meaning, missing)) = NAMED.iter().find(|of| of.0 == parameter.name)
        {
            parameter.description.get_or_insert_with(|| (*meaning).into());
            let not_found = || RefOr::T(problem(missing));
            operation.responses.responses.entry("404".into()).or_insert_with(not_found);
        }
    }
}

/// Adds the key of a request that is carried out once, and the refusals of its repetitions.
fn describe_repetition(operation: &mut Operation, refusals: &[Refusal]) {
    let text = "A text that the client chose for this request, for example a UUID: a repetition with the \
                same key has no further effect and gets the first response, with the header \
                `Idempotency-Replayed: true`. A string in double quotes, or its 1 to 128 visible ASCII \
                characters alone. Not after a refusal (4xx): then the key may be used again.";
    add_header(operation, "Idempotency-Key", text);
    let responses = &mut operation.responses.responses;
    for (status, words) in [
        (
            "409",
            "the request with this `Idempotency-Key` is in progress (with `Retry-After`), or its \
             outcome is unknown",
        ),
        ("422", "this `Idempotency-Key` was used with another request"),
    ] {
        let shared = refusals.iter().find(|refusal| refusal.0 == status);
        match (responses.get_mut(status), shared) {
            (Some(RefOr::T(response)), _) => {
                response.description = format!("{}; or {words}", response.description);
            }
            (_, Some((.., meaning))) => {
                let meaning = format!("{meaning}; or {words}");
                responses.insert(status.into(), RefOr::T(problem(&meaning)));
            }
            (_, None) => {
                responses.insert(status.into(), RefOr::T(problem(words)));
            }
        }
    }
    let done = responses.iter_mut().filter(|(status, _)| status.starts_with('2'));
    for (_, response) in done {
        if let RefOr::T(response) = response {
            let replayed =
                "`true` if this is the response to an earlier request with the same key.";
            let header = HeaderBuilder::new().description(Some(replayed)).build();
            response.headers.insert("Idempotency-Replayed".into(), header.into());
        }
    }
}

/// Adds the status that the client had, and what is answered if it is old.
fn describe_lateness(operation: &mut Operation) {
    let text = format!(
        "`at` of the newest status that the client had. If it is more than {} s old when the request arrives, the \
         request came late and is refused with 409, except to pause, stop or abort a run.",
        STATUS_AGE_MAX.as_secs()
    );
    add_header(operation, "Status-At", &text);
    if let Some(RefOr::T(response)) = operation.responses.responses.get_mut("409") {
        response.description += "; or the status of `Status-At` is too old";
    }
}

/// Adds the entity tag of what an operation shows, or changes.
fn describe_tags(operation: &mut Operation, shows: bool) {
    if !shows {
        let text =
            "Entity tags, or `*`: the change is made only if one of them is the present one.";
        add_header(operation, "If-Match", text);
        let changed = problem("it has changed since the entity tag of `If-Match` was read");
        operation.responses.responses.insert("412".into(), RefOr::T(changed));
        return;
    }
    add_header(operation, "If-None-Match", "Entity tags that the client has, or `*`.");
    let responses = &mut operation.responses.responses;
    let known = ResponseBuilder::new().description("the client has it already").build();
    responses.insert("304".into(), RefOr::T(known));
    for status in ["200", "304"] {
        if let Some(RefOr::T(response)) = responses.get_mut(status) {
            let tag = HeaderBuilder::new().description(Some("Entity tag, for `If-Match`.")).build();
            response.headers.insert("ETag".into(), tag.into());
        }
    }
}

fn add_header(operation: &mut Operation, name: &str, description: &str) {
    let header = ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Header)
        .description(Some(description))
        .schema(Some(Object::with_type(SchemaType::Type(Type::String))))
        .build();
    operation.parameters.get_or_insert_default().push(header.into());
}

fn complete_response(status: &str, response: &mut Response) {
    if response.description.is_empty() {
        response.description = meaning(status).into();
    }
    if status >= "400" {
        response.content.insert(PROBLEM.into(), problem_body().into());
    }
    if status == "401" {
        let header = HeaderBuilder::new().description(Some("Always `Bearer`.")).build();
        response.headers.insert("WWW-Authenticate".into(), header.into());
    }
}

/// A table in a format other than JSON.
fn table() -> Content {
    let bytes = Object::builder().schema_type(SchemaType::Type(Type::String));
    ContentBuilder::new().schema(Some(bytes.content_encoding("binary").build())).build()
}

/// Meaning of a status without a description.
fn meaning(status: &str) -> &'static str {
    match status {
        "101" => "the connection becomes a WebSocket",
        "200" => "the requested object",
        "201" => "the created object",
        "202" => "the request is accepted; its effect is shown elsewhere",
        "204" => "done, without a body",
        "206" => "the requested part of the file",
        _ => "see the status",
    }
}

fn problem_body() -> Content {
    ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemBody"))).build()
}

fn problem(meaning: &str) -> Response {
    let body = problem_body();
    let mut response = ResponseBuilder::new().description(meaning).content(PROBLEM, body).build();
    if meaning == NO_KEY.2 {
        complete_response("401", &mut response);
    }
    response
}

/// Rewrites schemas that are valid, but that generators refuse or cannot satisfy: tuples that end in
/// `items: false`, and flattened structs. Entries of pages become separate schemas.
fn simplify(components: &mut Components) {
    let names: Vec<String> = components.schemas.keys().cloned().collect();
    for name in names {
        let schema = components.schemas[&name].clone();
        if let RefOr::T(Schema::AllOf(all)) = &schema
            && let Some(object) = flattened(components, all)
        {
            components.schemas.insert(name.clone(), RefOr::T(Schema::Object(object)));
        }
        if let Some(of) = name.strip_prefix("Page_") {
            share_items(components, &name, of);
        }
        if let Some(schema) = components.schemas.get_mut(&name) {
            open_tuples(schema);
        }
    }
}

/// Makes the entries of a page a separate schema, with the name of their type.
fn share_items(components: &mut Components, page: &str, of: &str) {
    if let Some(RefOr::T(Schema::Object(object))) = components.schemas.get_mut(page)
        && let Some(RefOr::T(Schema::Array(list))) = object.properties.get_mut("items")
        && let ArrayItems::RefOrSchema(entry) = &mut list.items
        && let RefOr::T(schema) =
            std::mem::replace(entry.as_mut(), RefOr::Ref(Ref::from_schema_name(of)))
    {
        components.schemas.entry(of.into()).or_insert(RefOr::T(schema));
    }
}

/// The one object that satisfies all of several objects; `None` if one of them is none.
fn flattened(components: &Components, all: &AllOf) -> Option<Object> {
    let mut merged = Object::with_type(SchemaType::Type(Type::Object));
    merged.description = all.description.clone();
    for part in &all.items {
        let object = as_object(components, part)?;
        merged.properties.extend(object.properties);
        merged.required.extend(object.required);
        merged.description = merged.description.or(object.description);
    }
    Some(merged)
}

/// A schema as an object: a tagged enum is the object with the properties of all its variants.
fn as_object(components: &Components, schema: &RefOr<Schema>) -> Option<Object> {
    match schema {
        RefOr::Ref(to) => {
            let name = to.ref_location.rsplit('/').next()?;
            as_object(components, components.schemas.get(name)?)
        }
        RefOr::T(Schema::Object(object)) => Some(object.clone()),
        RefOr::T(Schema::AllOf(all)) => flattened(components, all),
        RefOr::T(Schema::OneOf(one)) => {
            let variants: Option<Vec<Object>> =
                one.items.iter().map(|variant| as_object(components, variant)).collect();
            variants?.into_iter().reduce(either)
        }
        RefOr::T(_) => None,
    }
}

/// An object that each of two variants satisfies.
fn either(mut one: Object, other: Object) -> Object {
    one.required.retain(|name| other.required.contains(name));
    for (name, schema) in other.properties {
        match (one.properties.get_mut(&name), schema) {
            (Some(RefOr::T(Schema::Object(tag))), RefOr::T(Schema::Object(more))) => {
                if let (Some(values), Some(more)) = (&mut tag.enum_values, more.enum_values) {
                    values.extend(more);
                }
            }
            (Some(_), _) => {}
            (None, schema) => {
                one.properties.insert(name, schema);
            }
        }
    }
    one
}

/// Removes `items: false` of tuples: their length is stated by `minItems` and `maxItems`.
fn open_tuples(schema: &mut RefOr<Schema>) {
    match schema {
        RefOr::T(Schema::Array(array)) => open_tuple(array),
        RefOr::T(Schema::Object(object)) => {
            object.properties.values_mut().for_each(open_tuples);
            if let Some(more) = &mut object.additional_properties
                && let AdditionalProperties::RefOr(more) = more.as_mut()
            {
                open_tuples(more);
            }
        }
        RefOr::T(Schema::OneOf(one)) => one.items.iter_mut().for_each(open_tuples),
        RefOr::T(Schema::AllOf(all)) => all.items.iter_mut().for_each(open_tuples),
        RefOr::T(_) | RefOr::Ref(_) => {}
    }
}

fn open_tuple(array: &mut Array) {
    match &mut array.items {
        ArrayItems::RefOrSchema(items) => open_tuples(items),
        ArrayItems::False => {
            let length = array.prefix_items.len();
            (array.min_items, array.max_items) = (Some(length), Some(length));
            array.items = ArrayItems::RefOrSchema(Box::new(Schema::default().into()));
        }
    }
}
