// SPDX-License-Identifier: MIT
// What becomes of the episodes of a rollout: how many ended, their steps, and the sums of their rewards.
//
// Rewards are whole numbers here: a category is looked up, any other is the word itself. An episode counts if
// it began with the rollout or within it, by its elapsed steps. The episode of an agent that ends before the others
// of its slot ends with it. Nothing can stall.
module pearl_statistics
  import pearl_pkg::*;
#(
    parameter int unsigned GROUPS = 4,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned AGENTS = 1,
    // Of an agent; whether they are categories, or else signed.
    parameter int unsigned REWARD_BITS = 1,
    parameter bit TABLED = 1'b1,
    parameter bit SIGNED = 1'b0,
    parameter int unsigned INDEX_BITS = 12,
    localparam int unsigned GROUP_BITS = index_bits(GROUPS)
) (
    input logic clk_i,
    input logic rst_ni,

    // Whole numbers of categories.
    input logic                  we_i,
    input logic [INDEX_BITS-1:0] index_i,
    input logic [          31:0] wdata_i,

    // A rollout begins; a step of it; how many steps it has done.
    input logic        clear_i,
    input logic        start_i,
    input logic [31:0] steps_i,

    // A group has been stepped.
    input logic                                          valid_i,
    input logic                                          last_i,
    input logic [GROUP_BITS-1:0]                         group_i,
    input logic [    PE_NUM-1:0][AGENTS*REWARD_BITS-1:0] rewards_i,
    input logic [    PE_NUM-1:0][              AGENTS:0] ters_i,
    // Agents that had ended before.
    input logic [    PE_NUM-1:0][            AGENTS-1:0] gone_i,
    input logic [    PE_NUM-1:0][      ELAPSED_BITS-1:0] elapsed_i,

    // All groups of this step are in the sums.
    output logic        done_o,
    output logic [63:0] episodes_o,
    output logic [63:0] truncated_o,
    output logic [63:0] lengths_o,
    output logic [63:0] returns_o
);

  localparam int unsigned ROWS = PE_NUM * AGENTS;
  localparam int unsigned LEVELS = $clog2(ROWS);
  localparam int unsigned LENGTH_BITS = ELAPSED_BITS + 1;
  // To the total, to what counts of it, through the adders, and to the sums.
  localparam int unsigned TO_TOTAL = READ_LATENCY + 1;
  localparam int unsigned TO_TERMS = TO_TOTAL + 1;
  localparam int unsigned TO_SUMS = TO_TERMS + LEVELS;

  logic [TO_SUMS:1] valid_q, last_q;
  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      valid_q <= '0;
      last_q  <= '0;
    end else begin
      valid_q <= {valid_q[TO_SUMS-1:1], valid_i};
      last_q  <= {last_q[TO_SUMS-1:1], valid_i && last_i};
    end
  end

  // A table takes a part of them.
  logic unused_host;
  assign unused_host = ^{we_i, index_i, wdata_i};

  logic [31:0] horizon_q;
  logic first_q;
  always_ff @(posedge clk_i) begin
    horizon_q <= steps_i + 1'b1;
    first_q   <= steps_i == '0;
  end

  // ---- Of each agent ----

  logic [ROWS-1:0][RETURN_BITS-1:0] running, totals_q, returns_q;
  logic [ROWS-1:0][LENGTH_BITS-1:0] lengths_q;
  logic [ROWS-1:0][1:0] episodes_q, truncated_q;
  logic [GROUP_BITS-1:0] group_late;

  pearl_delay #(
      .WIDTH (GROUP_BITS),
      .STAGES(TO_TOTAL)
  ) u_group (
      .clk_i,
      .d_i(group_i),
      .d_o(group_late)
  );

  pearl_ram #(
      .WIDTH(ROWS * RETURN_BITS),
      .DEPTH(GROUPS)
  ) u_running (
      .clk_i,
      .we_i   (valid_q[TO_TOTAL]),
      .waddr_i(group_late),
      .wdata_i(totals_q),
      .re_i   (valid_i),
      .raddr_i(group_i),
      .rdata_o(running)
  );

  for (genvar pe = 0; pe < PE_NUM; pe++) begin : gen_pe
    logic starts, whole;
    logic [ELAPSED_BITS-1:0] elapsed;

    pearl_delay #(
        .WIDTH (2 + ELAPSED_BITS),
        .STAGES(READ_LATENCY)
    ) u_elapsed (
        .clk_i,
        .d_i({first_q || elapsed_i[pe] <= 1, elapsed_i[pe] <= horizon_q, elapsed_i[pe]}),
        .d_o({starts, whole, elapsed})
    );

    for (genvar agent = 0; agent < AGENTS; agent++) begin : gen_agent
      localparam int unsigned ROW = pe * AGENTS + agent;
      logic [ REWARD_BITS-1:0] reward;
      logic [QUANTUM_BITS-1:0] quantum;
      logic ended, by_limit, ended_late, by_limit_late, counts_q, by_limit_q;
      logic [ELAPSED_BITS-1:0] elapsed_q;

      assign reward = rewards_i[pe][agent*REWARD_BITS+:REWARD_BITS];
      assign ended = !gone_i[pe][agent] && (ters_i[pe][agent] || ters_i[pe][AGENTS]);
      assign by_limit = !ters_i[pe][agent];

      if (TABLED) begin : gen_table
        // Of each category the lower bits, and then the higher ones.
        for (genvar half = 0; half < 2; half++) begin : gen_half
          localparam int unsigned BITS = half == 0 ? 32 : QUANTUM_BITS - 32;
          pearl_ram #(
              .WIDTH(BITS),
              .DEPTH(1 << REWARD_BITS)
          ) u_quanta (
              .clk_i,
              .we_i   (we_i && index_i[0] == 1'(half)),
              .waddr_i(index_i[REWARD_BITS:1]),
              .wdata_i(wdata_i[BITS-1:0]),
              .re_i   (valid_i),
              .raddr_i(reward),
              .rdata_o(quantum[half*32+:BITS])
          );
        end
      end else begin : gen_word
        logic [REWARD_BITS-1:0] late;
        pearl_delay #(
            .WIDTH (REWARD_BITS),
            .STAGES(READ_LATENCY)
        ) u_reward (
            .clk_i,
            .d_i(reward),
            .d_o(late)
        );
        assign quantum = SIGNED ? QUANTUM_BITS'($signed(late)) : QUANTUM_BITS'(late);
      end

      pearl_delay #(
          .WIDTH (2),
          .STAGES(READ_LATENCY)
      ) u_ended (
          .clk_i,
          .d_i({ended, by_limit}),
          .d_o({ended_late, by_limit_late})
      );

      always_ff @(posedge clk_i) begin
        totals_q[ROW] <= (starts ? '0 : running[ROW]) + RETURN_BITS'($signed(quantum));
        counts_q <= valid_q[READ_LATENCY] && ended_late && whole;
        by_limit_q <= by_limit_late;
        elapsed_q <= elapsed;
        returns_q[ROW] <= counts_q ? totals_q[ROW] : '0;
        lengths_q[ROW] <= counts_q ? {1'b0, elapsed_q} : '0;
        episodes_q[ROW] <= {1'b0, counts_q};
        truncated_q[ROW] <= {1'b0, counts_q && by_limit_q};
      end
    end
  end

  // ---- Of all of them ----

  logic [RETURN_BITS+LEVELS-1:0] returned;
  logic [LENGTH_BITS+LEVELS-1:0] length;
  logic [LEVELS+1:0] episodes, truncated;

  pearl_sum #(
      .TERMS(ROWS),
      .WIDTH(RETURN_BITS)
  ) u_returns (
      .clk_i,
      .terms_i(returns_q),
      .sum_o  (returned)
  );
  pearl_sum #(
      .TERMS(ROWS),
      .WIDTH(LENGTH_BITS)
  ) u_lengths (
      .clk_i,
      .terms_i(lengths_q),
      .sum_o  (length)
  );
  pearl_sum #(
      .TERMS(ROWS),
      .WIDTH(2)
  ) u_episodes (
      .clk_i,
      .terms_i(episodes_q),
      .sum_o  (episodes)
  );
  pearl_sum #(
      .TERMS(ROWS),
      .WIDTH(2)
  ) u_truncated (
      .clk_i,
      .terms_i(truncated_q),
      .sum_o  (truncated)
  );

  logic done_q;
  logic [63:0] episodes_sum_q, truncated_sum_q, lengths_sum_q, returns_sum_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni || clear_i) begin
      episodes_sum_q  <= '0;
      truncated_sum_q <= '0;
      lengths_sum_q   <= '0;
      returns_sum_q   <= '0;
    end else if (valid_q[TO_SUMS]) begin
      episodes_sum_q  <= episodes_sum_q + 64'($signed(episodes));
      truncated_sum_q <= truncated_sum_q + 64'($signed(truncated));
      lengths_sum_q   <= lengths_sum_q + 64'($signed(length));
      returns_sum_q   <= returns_sum_q + 64'($signed(returned));
    end
    if (!rst_ni || start_i) done_q <= 1'b0;
    else if (last_q[TO_SUMS]) done_q <= 1'b1;
  end

  assign done_o      = done_q;
  assign episodes_o  = episodes_sum_q;
  assign truncated_o = truncated_sum_q;
  assign lengths_o   = lengths_sum_q;
  assign returns_o   = returns_sum_q;

endmodule
