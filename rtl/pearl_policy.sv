// SPDX-License-Identifier: MIT
// The policy engine for networks and tables: observations of groups go in, rows of their actions come out, in the
// same order.
//
// Its user sees to it that no more than CREDITS groups are under way.
module pearl_policy
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_engine_pkg::*;
#(
    parameter int unsigned PE_NUM  = 4,
    parameter int unsigned CREDITS = 64
) (
    input logic clk_i,
    input logic rst_ni,

    // The host's words, of all sections.
    input logic                         we_i,
    input logic [POLICY_INDEX_BITS-1:0] index_i,
    input logic [                 31:0] wdata_i,

    // A step begins, with the slot that is its first.
    input  logic              start_i,
    input  logic [31:0]       first_slot_i,
    // As pearl_draws has them.
    input  logic              restart_i,
    input  logic              next_i,
    input  logic [ 1:0][31:0] seed_i,
    input  logic [63:0]       tick_i,
    output logic              keys_valid_o,

    input logic                            valid_i,
    input logic                            last_i,
    input logic [PE_NUM-1:0][OBS_BITS-1:0] obs_i,

    output logic                               valid_o,
    output logic [PE_NUM-1:0][ACTION_BITS-1:0] actions_o
);

  localparam int unsigned ROWS = PE_NUM * AGENTS;
  localparam int unsigned PLACES = at_least(2, 1 << $clog2(CREDITS));
  localparam int unsigned SECTION_INDEX_BITS = POLICY_INDEX_BITS - SECTION_BITS;

  // ---- The host's words, a section each ----

  logic [NumSections-1:0] we_q;
  logic [SECTION_INDEX_BITS-1:0] index_q;
  logic [31:0] wdata_q;

  always_ff @(posedge clk_i) begin
    for (int unsigned i = 0; i < NumSections; i++) begin
      we_q[i] <= rst_ni && we_i && index_i[POLICY_INDEX_BITS-1-:SECTION_BITS] == SECTION_BITS'(i);
    end
    index_q <= index_i[SECTION_INDEX_BITS-1:0];
    wdata_q <= wdata_i;
  end

  // How actions are chosen: whether they are drawn, and the shift of distances.
  logic drawn_q;
  logic [4:0] shift_q;
  always_ff @(posedge clk_i) begin
    if (we_q[Settings] && index_q == SECTION_INDEX_BITS'(SETTING_HEAD)) {drawn_q, shift_q} <= wdata_q[5:0];
  end

  // ---- What rows observe: elements, and which actions are allowed ----

  logic [ROWS-1:0][ELEMENTS-1:0][ELEMENT_BITS-1:0] elements;
  logic [ROWS-1:0][ACTIONS-1:0] seen_allowed, allowed;
  logic logits_valid;

  for (genvar row = 0; row < ROWS; row++) begin : gen_row
    logic [AGENT_OBS_BITS-1:0] word;
    assign word = obs_i[row/AGENTS][row%AGENTS*AGENT_OBS_BITS+:AGENT_OBS_BITS];
    for (genvar i = 0; i < ELEMENTS; i++) begin : gen_element
      logic [ELEMENT_WIDTHS[i]-1:0] field;
      assign field = word[ELEMENT_OFFSETS[i]+:ELEMENT_WIDTHS[i]];
      if (ELEMENT_SIGNS[i] == 1) begin : gen_signed
        assign elements[row][i] = ELEMENT_BITS'($signed(field));
      end else begin : gen_unsigned
        assign elements[row][i] = ELEMENT_BITS'(field);
      end
    end
    if (MASKED) begin : gen_masked
      assign seen_allowed[row] = word[AGENT_OBS_BITS-1-:ACTIONS];
    end else begin : gen_unmasked
      assign seen_allowed[row] = '1;
      // An observation may have bits that are no elements, such as padding.
      logic unused_word;
      assign unused_word = ^word;
    end
  end

  if (MASKED) begin : gen_masks
    logic unused_valid;
    pearl_fifo #(
        .WIDTH(ROWS * ACTIONS),
        .DEPTH(PLACES)
    ) u_masks (
        .clk_i,
        .rst_ni (rst_ni && !start_i),
        .push_i (valid_i),
        .data_i (seen_allowed),
        .valid_o(unused_valid),
        .data_o (allowed),
        .pop_i  (logits_valid)
    );
  end else begin : gen_no_masks
    assign allowed = seen_allowed;
  end

  // ---- Logits ----

  logic [ROWS-1:0][ACTIONS-1:0][LOGIT_BITS-1:0] logits;

  if (ENGINE == NetworkEngine || ENGINE == PlanesEngine) begin : gen_network
    logic inputs_valid, inputs_last;
    logic [ROWS-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] inputs;

    if (ENGINE == PlanesEngine) begin : gen_planes
      pearl_planes #(
          .ROWS      (ROWS),
          .INDEX_BITS(SECTION_INDEX_BITS)
      ) u_planes (
          .clk_i,
          .rst_ni,
          .we_i    (we_q),
          .index_i (index_q),
          .wdata_i (wdata_q),
          .valid_i,
          .last_i,
          .obs_i,
          .valid_o (inputs_valid),
          .last_o  (inputs_last),
          .values_o(inputs)
      );
      logic unused_elements;
      assign unused_elements = ^elements;
    end else begin : gen_numbers
      pearl_scaling #(
          .ROWS        (ROWS),
          .ELEMENTS    (ELEMENTS),
          .ELEMENT_BITS(ELEMENT_BITS),
          .PRODUCTS    (PRODUCTS),
          .VALUE_BITS  (VALUE_BITS),
          .INDEX_BITS  (SECTION_INDEX_BITS)
      ) u_scaling (
          .clk_i,
          .rst_ni,
          .we_i      (we_q),
          .index_i   (index_q),
          .wdata_i   (wdata_q),
          .valid_i,
          .last_i,
          .elements_i(elements),
          .valid_o   (inputs_valid),
          .last_o    (inputs_last),
          .values_o  (inputs)
      );
    end

    pearl_network #(
        .GROUP       (ROWS),
        .SIDE        (SIDE),
        .ROUNDS      (ROUNDS),
        .INPUTS      (INPUTS),
        .HIDDEN      (HIDDEN),
        .OUTPUTS     (ACTIONS),
        .LAYERS      (LAYERS),
        .PRODUCTS    (PRODUCTS),
        .WEIGHT_BITS (WEIGHT_BITS),
        .VALUE_BITS  (VALUE_BITS),
        .WEIGHT_WORDS(WEIGHT_WORDS),
        .INDEX_BITS  (SECTION_INDEX_BITS)
    ) u_network (
        .clk_i,
        .rst_ni,
        .we_i    (we_q),
        .index_i (index_q),
        .wdata_i (wdata_q),
        .valid_i (inputs_valid),
        .last_i  (inputs_last),
        .values_i(inputs),
        .valid_o (logits_valid),
        .logits_o(logits)
    );
  end else begin : gen_table
    logic unused_last;
    assign unused_last = last_i;

    pearl_lookup #(
        .ROWS        (ROWS),
        .ELEMENTS    (ELEMENTS),
        .ELEMENT_BITS(ELEMENT_BITS),
        .ACTIONS     (ACTIONS),
        .LOGIT_BITS  (LOGIT_BITS),
        .TABLE_ROWS  (TABLE_ROWS),
        .INDEX_BITS  (SECTION_INDEX_BITS)
    ) u_lookup (
        .clk_i,
        .rst_ni,
        .we_i      (we_q),
        .index_i   (index_q),
        .wdata_i   (wdata_q),
        .valid_i,
        .elements_i(elements),
        .valid_o   (logits_valid),
        .logits_o  (logits)
    );
  end

  // ---- Random numbers, of rows in their order ----

  logic [31:0] slot_q;
  logic [PE_NUM-1:0][AGENTS-1:0][31:0] draws;

  always_ff @(posedge clk_i) begin
    if (start_i) slot_q <= first_slot_i;
    else if (logits_valid) slot_q <= slot_q + 32'(PE_NUM);
  end

  if (DRAWN) begin : gen_draws
    pearl_draws #(
        .PE_NUM(PE_NUM),
        .DRAWS (AGENTS),
        .FIRST (POLICY_DRAW)
    ) u_draws (
        .clk_i,
        .rst_ni,
        .restart_i,
        .next_i,
        .seed_i,
        .tick_i,
        .valid_o(keys_valid_o),
        .slot_i (slot_q),
        .draws_o(draws)
    );
  end else begin : gen_no_draws
    logic unused_draws;
    assign unused_draws = ^{restart_i, next_i, seed_i, tick_i, slot_q};
    assign keys_valid_o = 1'b1;
    assign draws = '0;
  end

  // ---- Actions ----

  logic [ROWS-1:0][index_bits(ACTIONS)-1:0] chosen;

  pearl_choice #(
      .ROWS      (ROWS),
      .ACTIONS   (ACTIONS),
      .LOGIT_BITS(LOGIT_BITS),
      .DRAWN     (DRAWN)
  ) u_choice (
      .clk_i,
      .rst_ni,
      .drawn_i      (drawn_q),
      .shift_i      (shift_q),
      .table_we_i   (we_q[Chances]),
      .table_addr_i (index_q[ENTRY_BITS-1:0]),
      .table_wdata_i(wdata_q[CHANCE_BITS-1:0]),
      .valid_i      (logits_valid),
      .logits_i     (logits),
      .allowed_i    (allowed),
      .draws_i      (draws),
      .valid_o,
      .actions_o    (chosen)
  );

  for (genvar i = 0; i < ROWS; i++) begin : gen_action
    localparam int unsigned BITS = ACTION_BITS / AGENTS;
    assign actions_o[i/AGENTS][i%AGENTS*BITS+:BITS] = BITS'(chosen[i]);
  end

endmodule
