// SPDX-License-Identifier: MIT
// From logits to actions, a group of rows a cycle: each row takes the greatest of its logits that are allowed, the
// first of equals; or draws one, with weights that a table gives for its distance from the greatest.
//
// Nothing in it can stall.
module pearl_choice
  import pearl_pkg::*;
#(
    parameter int unsigned ROWS = 4,
    parameter int unsigned ACTIONS = 4,
    parameter int unsigned LOGIT_BITS = 32,
    // Whether it is able to draw.
    parameter bit DRAWN = 1'b1,
    localparam int unsigned ACTION_BITS = index_bits(ACTIONS)
) (
    input logic clk_i,
    input logic rst_ni,

    // Whether actions are drawn, and by how much distances are shifted to the right.
    input logic       drawn_i,
    input logic [4:0] shift_i,

    input logic                   table_we_i,
    input logic [ ENTRY_BITS-1:0] table_addr_i,
    input logic [CHANCE_BITS-1:0] table_wdata_i,

    input logic                                         valid_i,
    input logic [ROWS-1:0][ACTIONS-1:0][LOGIT_BITS-1:0] logits_i,
    input logic [ROWS-1:0][ACTIONS-1:0]                 allowed_i,
    // DRAW_LATENCY cycles later, a random number for each row.
    input logic [ROWS-1:0][       31:0]                 draws_i,

    output logic                             valid_o,
    output logic [ROWS-1:0][ACTION_BITS-1:0] actions_o
);

  localparam int unsigned COUNT_BITS = $clog2(ACTIONS + 1);
  localparam int unsigned END_BITS = CHANCE_BITS + $clog2(ACTIONS);
  localparam int unsigned DISTANCE_BITS = at_least(LOGIT_BITS, ENTRY_BITS) + 1;
  // Cycles until the greatest is known; until the weights are added up to the number that is drawn below the sum;
  // and from there to the action.
  localparam int unsigned TO_BEST = ACTIONS;
  localparam int unsigned TO_ENDS = TO_BEST + 2 + READ_LATENCY + ACTIONS;
  localparam int unsigned TO_PRODUCT = at_least(TO_ENDS, DRAW_LATENCY);
  localparam int unsigned PRODUCT_STAGES = 3;
  localparam int unsigned STAGES = DRAWN ? TO_PRODUCT + PRODUCT_STAGES + 1 : TO_BEST;

  logic [STAGES:1] valid_q;
  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= STAGES'({valid_q, valid_i});
  end
  assign valid_o = valid_q[STAGES];

  logic unused_settings;
  assign unused_settings = ^{drawn_i, shift_i, table_we_i, table_addr_i, table_wdata_i, draws_i};

  for (genvar row = 0; row < ROWS; row++) begin : gen_row

    // ---- The greatest, one more logit a stage ----

    typedef struct packed {
      logic found;
      logic [ACTION_BITS-1:0] best;
      logic signed [LOGIT_BITS-1:0] greatest;
      logic [ACTIONS-1:0] allowed;
      logic [ACTIONS-1:0][LOGIT_BITS-1:0] logits;
    } search_t;

    for (genvar i = 0; i < ACTIONS; i++) begin : gen_search
      search_t so_far, updated, found_q;
      if (i == 0) begin : gen_first
        assign so_far = '{logits: logits_i[row], allowed: allowed_i[row], default: '0};
      end else begin : gen_next
        assign so_far = gen_search[i-1].found_q;
      end
      always_comb begin
        updated = so_far;
        if (so_far.allowed[i] && (!so_far.found || $signed(so_far.logits[i]) > so_far.greatest)) begin
          updated.found    = 1'b1;
          updated.best     = ACTION_BITS'(i);
          updated.greatest = so_far.logits[i];
        end
      end
      always_ff @(posedge clk_i) found_q <= updated;
    end

    search_t searched;
    assign searched = gen_search[ACTIONS-1].found_q;

    logic unused_search;
    assign unused_search = ^searched;

    if (!DRAWN) begin : gen_greatest
      assign actions_o[row] = searched.best;
    end else begin : gen_drawn

      // ---- Their weights: how far is each from the greatest, and what has the table for that ----

      logic [ACTIONS-1:0][ENTRY_BITS-1:0] entries_q;
      logic [ACTIONS-1:0][CHANCE_BITS-1:0] chances, weights;
      logic [ACTIONS-1:0] allowed;
      logic [ACTION_BITS-1:0] best;

      for (genvar i = 0; i < ACTIONS; i++) begin : gen_weight
        logic [DISTANCE_BITS-1:0] distance_q, shifted;
        // Of logits that are not allowed it does not matter; none of the others is greater.
        always_ff @(posedge clk_i) begin
          distance_q <= DISTANCE_BITS'($signed(
              searched.greatest
          )) - DISTANCE_BITS'($signed(
              searched.logits[i]
          ));
          entries_q[i] <= shifted >= DISTANCE_BITS'(ENTRIES) ? '1 : shifted[ENTRY_BITS-1:0];
        end
        assign shifted = distance_q >> shift_i;

        pearl_ram #(
            .WIDTH(CHANCE_BITS),
            .DEPTH(ENTRIES)
        ) u_table (
            .clk_i,
            .we_i   (table_we_i),
            .waddr_i(table_addr_i),
            .wdata_i(table_wdata_i),
            .re_i   (drawn_i),
            .raddr_i(entries_q[i]),
            .rdata_o(chances[i])
        );
        assign weights[i] = allowed[i] ? chances[i] : '0;
      end

      pearl_delay #(
          .WIDTH (ACTIONS),
          .STAGES(2 + READ_LATENCY)
      ) u_allowed (
          .clk_i,
          .d_i(searched.allowed),
          .d_o(allowed)
      );
      pearl_delay #(
          .WIDTH (ACTION_BITS),
          .STAGES(STAGES - 1 - TO_BEST)
      ) u_best (
          .clk_i,
          .d_i(searched.best),
          .d_o(best)
      );

      // ---- Where the weights of each end, one more a stage ----

      typedef struct packed {
        logic [ACTIONS-1:0][CHANCE_BITS-1:0] weights;
        logic [ACTIONS-1:0][END_BITS-1:0] ends;
      } sums_t;

      for (genvar i = 0; i < ACTIONS; i++) begin : gen_end
        sums_t so_far, updated, sums_q;
        if (i == 0) begin : gen_first
          assign so_far = '{weights: weights, ends: '0};
          always_comb begin
            updated = so_far;
            updated.ends[0] = END_BITS'(so_far.weights[0]);
          end
        end else begin : gen_next
          assign so_far = gen_end[i-1].sums_q;
          always_comb begin
            updated = so_far;
            updated.ends[i] = so_far.ends[i-1] + END_BITS'(so_far.weights[i]);
          end
        end
        always_ff @(posedge clk_i) sums_q <= updated;
      end

      // ---- A number below their sum, and how many of them end at it or so_far ----

      logic [ACTIONS-1:0][END_BITS-1:0] ends, ends_late;
      logic [31:0] draw, draw_q;
      logic [END_BITS-1:0] total_q, number_q;
      logic [31+END_BITS:0] product_q;
      logic [COUNT_BITS-1:0] count;
      logic [ACTION_BITS-1:0] action_q;
      logic unused_product;
      assign unused_product = ^{product_q[31:0], gen_end[ACTIONS-1].sums_q};

      pearl_delay #(
          .WIDTH (ACTIONS * END_BITS),
          .STAGES(TO_PRODUCT - TO_ENDS)
      ) u_ends (
          .clk_i,
          .d_i(gen_end[ACTIONS-1].sums_q.ends),
          .d_o(ends)
      );
      pearl_delay #(
          .WIDTH (32),
          .STAGES(TO_PRODUCT - DRAW_LATENCY)
      ) u_draw (
          .clk_i,
          .d_i(draws_i[row]),
          .d_o(draw)
      );
      pearl_delay #(
          .WIDTH (ACTIONS * END_BITS),
          .STAGES(PRODUCT_STAGES)
      ) u_ends_late (
          .clk_i,
          .d_i(ends),
          .d_o(ends_late)
      );

      always_comb begin
        count = '0;
        for (int unsigned i = 0; i < ACTIONS; i++) begin
          count += COUNT_BITS'(number_q >= ends_late[i]);
        end
      end

      always_ff @(posedge clk_i) begin
        draw_q    <= draw;
        total_q   <= ends[ACTIONS-1];
        product_q <= (32 + END_BITS)'(draw_q) * (32 + END_BITS)'(total_q);
        number_q  <= product_q[32+:END_BITS];
        action_q  <= drawn_i && ends_late[ACTIONS-1] != '0 ? ACTION_BITS'(count) : best;
      end
      assign actions_o[row] = action_q;
    end
  end

endmodule
